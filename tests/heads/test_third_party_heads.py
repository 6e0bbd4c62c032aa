"""Heads of a third party get what their abilities allow: the shared kernel, and masks by what their scores mean."""

import pytest
import torch
from tests.contracts.kernel_head import KernelHead

from icub_core.interfaces.abilities import SharesKernel
from icub_core.interfaces.online_head import probabilities
from icub_segmenters.baselines.ours_serial import OursSerial
from icub_segmenters.faithful_rpn import FaithfulRpn
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.heads.linear import Linear
from icub_segmenters.masks import MAX_CENTERS, OnlineMasks
from icub_segmenters.minibootstrap import Minibootstrap
from icub_segmenters.shared_rpn import SharedRpn
from icub_testing.checks import run_checks
from icub_testing.tiny import tiny_class


class Logistic(tiny_class("online_head")):
    """Log odds in the way of linear discriminant analysis: the tiny head's regression, stretched."""

    score = "log_odds"

    def decision_function(self, X):
        return 8 * super().decision_function(X)


class Kernel(KernelHead):
    """A kernel head that is no FALKON; remembers what it was asked for."""

    fits = systems = 0
    counts: list[int] = []

    def fit(self, X, Y, sample_weight=None):
        Kernel.fits += 1
        super().fit(X, Y, sample_weight)

    def kernel_system(self, centers, problems):
        Kernel.systems += 1
        Kernel.counts.append(len(centers))
        return super().kernel_system(centers, problems)


def samples(seed=0):
    generator = torch.Generator().manual_seed(seed)
    label = torch.arange(3).repeat_interleave(20)
    X = torch.cat([4 * torch.eye(6)[label] + torch.randn(60, 6, generator=generator), torch.randn(300, 6)])
    return X, torch.cat([label, torch.full((300,), -1)])


@pytest.mark.parametrize("head", [Logistic, KernelHead, Falkon, Linear])
def test_they_keep_the_contract(head):
    assert {r.name: r.problem for r in run_checks("online_head", head) if r.problem} == {}


def test_a_kernel_head_that_is_no_falkon_is_trained_on_one_system():
    X, label = samples()
    Kernel.fits = Kernel.systems = 0
    trained = Minibootstrap(3, 100).train_shared(Kernel, X, label, torch.nonzero(label < 0).flatten(), 3)
    assert (Kernel.systems, Kernel.fits) == (1, 0)
    assert (trained.decision_function(X)[:60].argmax(dim=1) == label[:60]).all()


@pytest.mark.parametrize(
    ("head", "way"), [(Kernel, SharedRpn), (Falkon, SharedRpn), (Logistic, FaithfulRpn), (Linear, FaithfulRpn)]
)
def test_a_kernel_head_proposes_for_all_anchor_types_at_once(head, way):
    assert type(OursSerial(tiny_class("feature_extractor")(), head).rpn) is way


@pytest.mark.parametrize("make", [Logistic, Kernel, Falkon, Linear])
def test_masks_are_cut_where_a_head_is_undecided(make):
    """A pixel belongs to the object where the score is above 0, whatever the scale of the scores is."""
    masks, generator = OnlineMasks(make), torch.Generator().manual_seed(0)
    features = torch.rand(8, 14, 14, 3, generator=generator)
    of_object = torch.zeros(8, 56, 56, dtype=torch.bool)
    of_object[:, :28] = True
    features[:, :7, :, 0] += 1.5
    boxes = torch.tensor([[0.0, 0.0, 56.0, 56.0]]).repeat(8, 1)
    masks.observe(features, boxes, of_object, torch.zeros(8, dtype=torch.int64), generator)
    masks.train(0)

    class Extractor:
        mask_size = 14

        def mask_features(self, image, boxes):
            return features[: len(boxes)]

    values = masks.predict(Extractor(), None, boxes[:4], torch.zeros(4, dtype=torch.int64))
    scores = masks.heads[0].decision_function(masks.scales[0](features[:4].flatten(0, 2)))
    assert torch.equal(values.flatten() > 0.5, scores.flatten() > 0)
    if make is Logistic:
        torch.testing.assert_close(values.flatten(), scores.flatten().sigmoid())


def test_a_head_is_limited_in_its_centers_without_being_changed():
    made = []

    def make():
        made.append(Falkon(n_centers=1000))
        return made[-1]

    masks, generator = OnlineMasks(make), torch.Generator().manual_seed(0)
    features = torch.randn(20, 14, 14, 3, generator=generator)
    mask = torch.ones(20, 56, 56, dtype=torch.bool)
    mask[:, 28:] = False
    masks.observe(features, torch.tensor([[0.0, 0, 56, 56]]).repeat(20, 1), mask, torch.zeros(20).long(), generator)
    masks.train(0)
    assert len(masks.heads[0].state_dict()["centers"]) == MAX_CENTERS
    assert [head.n_centers for head in made] == [1000]
    assert all(isinstance(head, SharesKernel) for head in made)


def test_probabilities_of_scores():
    scores = torch.tensor([-3.0, -1.0, 0.0, 0.5, 2.0])
    assert probabilities(scores, "estimate").tolist() == [0.0, 0.0, 0.5, 0.75, 1.0]
    torch.testing.assert_close(probabilities(scores, "log_odds"), scores.sigmoid())
