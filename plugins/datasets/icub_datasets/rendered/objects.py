"""The objects of the rendered TARGET-TASKs; none of their shapes occurs in the FEATURE-TASK."""

from __future__ import annotations

from functools import lru_cache

from icub_core.construct import build
from icub_core.scene import ObjectSpec

YCB = (
    "003_cracker_box", "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle", "008_pudding_box",
    "010_potted_meat_can", "021_bleach_cleanser", "035_power_drill",
)  # fmt: skip
HOUSEHOLD = (
    "bottle_2", "bowl_1", "brush_1", "car_4", "dumbbell_0", "goblet_4", "hammer_7", "jar_5", "jug_7", "mug_0", "pan_5",
    "spray_6", "teapot_3",
)  # fmt: skip
"""Of the object set ``household``, no two of a kind."""
TABLETOP = YCB + HOUSEHOLD
HANDHELD = (
    "003_cracker_box", "004_sugar_box", "006_mustard_bottle", "010_potted_meat_can", "021_bleach_cleanser",
    "035_power_drill", "dumbbell_0", "hammer_7", "mug_0",
)  # fmt: skip
"""Seven of HO-3D's nine kinds; a dumbbell and a hammer stand in for its banana and scissors."""
CLUTTER = ("carton_0", "bowl_6", "screwdriver_6", "stapler_4", "tube_0", "wrench_3")
"""Stand in the background of the hand-held task and are never taught."""


@lru_cache(maxsize=64)
def target_object(name: str) -> ObjectSpec:
    """Build one object by its name, from the object set it belongs to."""
    return build("objects", "ycb_primitives" if name in YCB else "household").get(name)
