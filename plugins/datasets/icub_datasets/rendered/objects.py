"""The objects of the rendered TARGET-TASKs; none of their shapes occurs in the FEATURE-TASK."""

from __future__ import annotations

from functools import lru_cache

from icub_core.construct import build
from icub_core.scene import ObjectSpec

YCB = (
    "003_cracker_box", "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle", "008_pudding_box",
    "010_potted_meat_can", "021_bleach_cleanser", "035_power_drill",
)  # fmt: skip
RANDOM = (
    "random_014", "random_021", "random_035", "random_049", "random_063", "random_077", "random_084", "random_112",
    "random_140", "random_210", "random_266", "random_287", "random_434",
)  # fmt: skip
"""Chosen by hand among those that the FEATURE-TASK does not use (a test checks that), of household size."""
TABLETOP = YCB + RANDOM
HANDHELD = (
    "003_cracker_box", "004_sugar_box", "006_mustard_bottle", "010_potted_meat_can", "021_bleach_cleanser",
    "035_power_drill", "random_049", "random_210", "random_266",
)  # fmt: skip
"""Six of HO-3D's nine; the others stand in for its banana, mug and scissors."""
CLUTTER = ("random_147", "random_154", "random_203", "random_231", "random_420", "random_427")
"""Stand in the background of the hand-held task and are never taught."""
RANDOM_SIZE = [0.08, 0.18]
"""Lowest and highest largest extent of a random object, meters."""


@lru_cache(maxsize=64)
def target_object(name: str) -> ObjectSpec:
    """Build one object by its name, from the object set it belongs to."""
    if name.startswith("random_"):
        return build("objects", {"plugin": "random1000", "size": RANDOM_SIZE}).get(name)
    return build("objects", "ycb_primitives").get(name)
