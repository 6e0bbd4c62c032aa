"""The network of `vgn`: the original's size and names, files of both kinds, and what training computes of it."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import save_file

from icub_core.errors import WeightsError
from icub_grasp_generators.vgn.network import HAND, Meaning, VgnNetwork, load_network, save_network
from icub_grasp_generators.vgn.network_training import loss_of
from icub_grasp_generators.vgn.samples import Batch

ORIGINAL = {
    "encoder.conv1": (16, 1, 5), "encoder.conv2": (32, 16, 3), "encoder.conv3": (64, 32, 3),
    "decoder.conv1": (64, 64, 3), "decoder.conv2": (32, 64, 3), "decoder.conv3": (16, 32, 5),
    "conv_qual": (1, 16, 5), "conv_rot": (4, 16, 5), "conv_width": (1, 16, 5),
}  # fmt: skip
"""Outputs, inputs and kernel of every layer of the released network."""


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return VgnNetwork().eval()


def original_file(path):
    torch.manual_seed(1)
    tensors = {}
    for name, (out, into, kernel) in ORIGINAL.items():
        tensors[f"{name}.weight"] = 0.1 * torch.randn(out, into, kernel, kernel, kernel)
        tensors[f"{name}.bias"] = 0.1 * torch.randn(out)
    torch.save(tensors, path)
    return tensors


def test_size(network):
    assert sum(p.numel() for p in network.parameters()) == 313_238


def test_shapes_and_ranges(network):
    with torch.no_grad():
        quality, rotation, width = network(torch.rand(2, 1, 40, 40, 40))
    assert quality.shape == width.shape == (2, 1, 40, 40, 40)
    assert rotation.shape == (2, 4, 40, 40, 40)
    assert 0 <= quality.min() <= quality.max() <= 1
    torch.testing.assert_close(rotation.norm(dim=1), torch.ones(2, 40, 40, 40))


def test_the_original_file_fits_and_counts_as_a_gripper_s(tmp_path):
    tensors = original_file(tmp_path / "vgn_conv.pth")
    network, meaning, _ = load_network(str(tmp_path / "vgn_conv.pth"))
    assert meaning == Meaning("gripper")
    assert network.state_dict().keys() == tensors.keys()
    # the released forward pass, layer by layer
    f = torch.nn.functional
    x = torch.rand(1, 1, 40, 40, 40)
    layer = lambda name, x, **k: f.conv3d(x, tensors[f"{name}.weight"], tensors[f"{name}.bias"], **k)  # noqa: E731
    y = f.relu(layer("encoder.conv1", x, stride=2, padding=2))
    y = f.relu(layer("encoder.conv2", y, stride=2, padding=1))
    y = f.relu(layer("encoder.conv3", y, stride=2, padding=1))
    y = f.interpolate(f.relu(layer("decoder.conv1", y, padding=1)), 10)
    y = f.interpolate(f.relu(layer("decoder.conv2", y, padding=1)), 20)
    y = f.interpolate(f.relu(layer("decoder.conv3", y, padding=2)), 40)
    quality, rotation, width = network(x)
    torch.testing.assert_close(quality, torch.sigmoid(layer("conv_qual", y, padding=2)), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(rotation, f.normalize(layer("conv_rot", y, padding=2), dim=1), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(width, layer("conv_width", y, padding=2), atol=1e-3, rtol=1e-3)


def test_own_files_keep_weights_and_meaning(network, tmp_path):
    save_network(tmp_path / "own.safetensors", network, Meaning(HAND))
    again, meaning, _ = load_network(str(tmp_path / "own.safetensors"))
    assert meaning == Meaning(HAND)
    x = torch.rand(1, 1, 40, 40, 40)
    for one, other in zip(network(x), again(x), strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize("low", [0, 13])
def test_single_voxels_are_those_of_the_whole(network, low):
    torch.manual_seed(low)
    x, scene = torch.rand(3, 1, 40, 40, 40), torch.randint(0, 3, (50,))
    index = torch.randint(low, 40 - low, (50, 3))
    quality, rotation, width = network(x)
    out = network.at_voxels(x, scene, index)
    at = (scene, slice(None), *index.T)
    torch.testing.assert_close(torch.sigmoid(out[:, :1]), quality[at])
    torch.testing.assert_close(torch.nn.functional.normalize(out[:, 1:5], dim=1), rotation[at])
    torch.testing.assert_close(out[:, 5:], width[at])


class Evil:
    def __reduce__(self):
        return (print, ("executed",))


def test_bad_files(network, tmp_path, capsys):
    with pytest.raises(WeightsError, match="no shipped VGN weights|shipped VGN weights"):
        load_network("icub_hnd")
    with pytest.raises(WeightsError, match="there is no VGN weight file"):
        load_network(str(tmp_path / "absent.pth"))
    (tmp_path / "noise.pth").write_bytes(b"not weights")
    (tmp_path / "noise.safetensors").write_bytes(b"not weights")
    save_file({"x": torch.zeros(1)}, tmp_path / "foreign.safetensors")
    torch.save([1, 2], tmp_path / "list.pth")
    torch.save({"encoder.conv1.weight": Evil()}, tmp_path / "evil.pth")
    tensors = original_file(tmp_path / "whole.pth")
    torch.save({k: v for k, v in tensors.items() if k != "conv_rot.bias"}, tmp_path / "part.pth")
    torch.save(tensors | {"conv_rot.bias": torch.zeros(3)}, tmp_path / "shape.pth")
    for name in ("noise.pth", "noise.safetensors", "foreign.safetensors", "list.pth", "evil.pth"):
        with pytest.raises(WeightsError, match=name):
            load_network(str(tmp_path / name))
    for name in ("part.pth", "shape.pth"):
        with pytest.raises(WeightsError, match="conv_rot.bias"):
            load_network(str(tmp_path / name))
    assert "executed" not in capsys.readouterr().out


def batch_of(quaternion, label=1.0, width=4.0):
    one = torch.zeros(1)
    return Batch(one, one, one, torch.tensor([label]), torch.tensor([quaternion]), torch.tensor([width]))


def out_of(logit, quaternion, width=4.0):
    return torch.tensor([[logit, *quaternion, width]])


def test_loss_takes_a_gripper_s_half_turn_but_not_a_hand_s():
    straight, turned, other = [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    sure = 20.0
    assert loss_of(out_of(sure, straight), batch_of(turned), "gripper") < 1e-6
    assert loss_of(out_of(sure, straight), batch_of(turned), "hand") > 0.9
    assert loss_of(out_of(sure, straight), batch_of(other), "gripper") > 0.9
    assert loss_of(out_of(sure, [0.0, 0.0, 0.0, -1.0]), batch_of(straight), "hand") < 1e-6
    # what was not held teaches quality alone
    assert loss_of(out_of(-sure, straight, 9.0), batch_of(other, label=0.0), "gripper") < 1e-6
    assert loss_of(out_of(sure, straight, 9.0), batch_of(straight), "gripper") == pytest.approx(0.25, abs=1e-3)
    assert loss_of(out_of(-sure, straight), batch_of(straight), "hand") > 10
