"""Names that the pipelines teach and grasp when the user does not choose."""

import pytest

from icub_pipelines.settings import target_name, taught_names

PREFERRED = ("004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle", "010_potted_meat_can", "021_bleach_cleanser")
FOLDER = ("bowl", "cup", "fork", "mug", "pan", "plate")


@pytest.mark.parametrize(
    ("chosen", "known", "expected"),
    [
        (None, (*PREFERRED, "035_power_drill"), list(PREFERRED)),
        (None, FOLDER, list(FOLDER[:5])),
        (None, FOLDER[:2], list(FOLDER[:2])),
        (["mug"], FOLDER, ["mug"]),
        ([], FOLDER, []),
        (["spoon"], FOLDER, ["spoon"]),
    ],
)
def test_what_is_taught_is_chosen_or_preferred_or_what_the_set_has(chosen, known, expected):
    assert taught_names(chosen, PREFERRED, known, 5) == expected


def test_what_is_grasped_is_chosen_or_preferred_or_the_first():
    assert target_name("mug", "006_mustard_bottle", FOLDER) == "mug"
    assert target_name(None, "006_mustard_bottle", PREFERRED) == "006_mustard_bottle"
    assert target_name(None, "006_mustard_bottle", FOLDER) == "bowl"
