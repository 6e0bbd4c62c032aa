"""Contract of feature extractors."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from icub_core.interfaces.abilities import HasMaskBranch, ProposesCells
from icub_core.interfaces.feature_extractor import FeatureExtractor
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_close, expect_same, expect_tensor
from icub_testing.tiny.things import draw_frame

BATCH_TOLERANCE = 1e-4
"""Features of a box may differ by rounding between batches, relative to the largest feature."""


def _image(seed: int = 0, size: tuple[int, int] = (120, 160)) -> NDArray[np.uint8]:
    return draw_frame({"red": (40, 60, 18), "blue": (110, 50, 14)}, seed=seed, size=size)[0].rgb


def _boxes() -> torch.Tensor:
    return torch.tensor([[10.0, 12.0, 70.0, 80.0], [90.0, 30.0, 130.0, 70.0], [0.0, 0.0, 160.0, 120.0]])


def check_dimensions(make: Make) -> None:
    """Its dimensions are positive and constant."""
    plugin: FeatureExtractor = make()
    before = (plugin.region_dim, plugin.mask_dim, plugin.mask_size)
    plugin.extract(_image())
    expect(all(isinstance(n, int) and n > 0 for n in before), "positive whole numbers", before)
    expect_same(before, (plugin.region_dim, plugin.mask_dim, plugin.mask_size), "dimensions before and after use")


def check_proposals(make: Make) -> None:
    """Proposals are boxes inside the image with their scores, best first."""
    found = make().extract(_image())
    expect_tensor(found.proposals, (len(found.proposals), 4), "proposals")
    expect_tensor(found.scores, (len(found.proposals),), "scores")
    expect(len(found.proposals) > 0, "at least one proposal for an image with two discs", 0)
    x0, y0, x1, y1 = found.proposals.unbind(dim=1)
    inside = (x0 >= 0) & (y0 >= 0) & (x1 <= 160) & (y1 <= 120) & (x1 > x0) & (y1 > y0)
    expect(inside.all(), "0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height", found.proposals[~inside][:1].tolist())
    expect((found.scores.diff() <= 0).all(), "scores in falling order", found.scores[:5].tolist())


def check_image_size(make: Make) -> None:
    """It takes images of any size and reports height and width of the original."""
    plugin = make()
    for size in ((97, 131), (240, 320)):
        found = plugin.extract(_image(size=size))
        expect(tuple(found.image_size) == size, f"image_size {size}", found.image_size)
        expect(bool((found.proposals[:, 2] <= size[1]).all()), f"proposals in original pixels, x1 <= {size[1]}", "more")


def check_region_features(make: Make) -> None:
    """Boxes are described by float32 vectors of region_dim."""
    plugin = make()
    described = plugin.region_features(plugin.extract(_image()), _boxes())
    expect_tensor(described, (3, plugin.region_dim), "region features")


def check_mask_features(make: Make) -> None:
    """Pixels of boxes are described by float32 vectors of mask_dim on a square grid of mask_size."""
    plugin = make()
    described = plugin.mask_features(plugin.extract(_image()), _boxes())
    expect_tensor(described, (3, plugin.mask_size, plugin.mask_size, plugin.mask_dim), "mask features")


def check_no_boxes(make: Make) -> None:
    """No boxes give no features, without an exception."""
    plugin = make()
    found = plugin.extract(_image())
    expect_tensor(
        plugin.region_features(found, torch.zeros((0, 4))), (0, plugin.region_dim), "region features of no box"
    )
    shape = (0, plugin.mask_size, plugin.mask_size, plugin.mask_dim)
    expect_tensor(plugin.mask_features(found, torch.zeros((0, 4))), shape, "mask features of no box")


def check_boxes_apart(make: Make) -> None:
    """A box is described alike alone and among others."""
    plugin = make()
    found = plugin.extract(_image())
    together, alone = plugin.region_features(found, _boxes()), plugin.region_features(found, _boxes()[1:2])
    expect_close(together[1:2], alone, BATCH_TOLERANCE * float(alone.abs().max()), "features of one box")


def check_repeatable(make: Make) -> None:
    """The same image gives the same numbers, whatever was seen in between."""
    plugin = make()
    first = plugin.extract(_image())
    first_regions = plugin.region_features(first, _boxes())
    plugin.extract(_image(seed=1))
    again = plugin.extract(_image())
    expect_same(first.proposals, again.proposals, "proposals of one image")
    expect_same(first_regions, plugin.region_features(again, _boxes()), "region features of one image")


def check_inputs_unchanged(make: Make) -> None:
    """Images and boxes that are passed in are not changed."""
    plugin = make()
    image, boxes = _image(), _boxes()
    found = plugin.extract(image)
    plugin.region_features(found, boxes)
    plugin.mask_features(found, boxes)
    expect_same(image, _image(), "the image before and after")
    expect_same(boxes, _boxes(), "the boxes before and after")


def check_tells_apart(make: Make) -> None:
    """Different things have different features."""
    plugin = make()
    regions = plugin.region_features(plugin.extract(_image()), _boxes())
    expect(not torch.allclose(regions[0], regions[1]), "different features of different objects", "the same")


def check_refined_boxes(make: Make) -> None:
    """Refinement gives a box for a box, in original pixels, and none for none."""
    plugin = make()
    found = plugin.extract(_image())
    refined = plugin.refined_boxes(found, _boxes())
    expect_tensor(refined, (3, 4), "refined boxes")
    expect(bool((refined[:, 2:] >= refined[:, :2]).all()), "x0 <= x1 and y0 <= y1", refined.tolist())
    middle = (refined[0, :2] + refined[0, 2:]) / 2
    expect(
        bool(((middle > 0) & (middle < torch.tensor([160.0, 120.0]))).all()),
        "a middle inside the image",
        middle.tolist(),
    )
    expect_tensor(plugin.refined_boxes(found, torch.zeros((0, 4))), (0, 4), "refined boxes of no box")


def check_mask_probabilities(make: Make) -> None:
    """A pre-trained mask branch, where there is one, gives a probability for each pixel of a box."""
    plugin: FeatureExtractor = make()
    if not isinstance(plugin, HasMaskBranch):
        return
    masks = plugin.mask_probabilities(plugin.extract(_image()), _boxes())
    expect_tensor(masks, (3, plugin.mask_size, plugin.mask_size), "mask probabilities")
    expect(bool(((masks >= 0) & (masks <= 1)).all()), "probabilities in 0..1", (float(masks.min()), float(masks.max())))


def check_rpn_cells(make: Make) -> None:
    """Cells for an on-line region proposal network, where there are any, agree in number with their anchors."""
    plugin: FeatureExtractor = make()
    if not isinstance(plugin, ProposesCells):
        return
    cells = plugin.rpn_cells(plugin.extract(_image()))
    locations, anchors = cells.anchors.shape[:2]
    expect_tensor(cells.features, (locations, cells.features.shape[-1]), "features of cells")
    expect_tensor(cells.anchors, (locations, anchors, 4), "anchors")
    expect(cells.types.shape == (locations, anchors), f"types of ({locations}, {anchors})", tuple(cells.types.shape))
    expect(cells.types.dtype == torch.int64 and int(cells.types.min()) == 0, "int64 types from 0", cells.types.dtype)
