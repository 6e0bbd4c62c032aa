"""The transformer extractor reads DINOv2's torch hub layout and computes what it means."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from icub_core.errors import WeightsError
from icub_segmenters.feature_extractors.dinov2 import DinoV2, load_transformer
from icub_testing.contracts import FeatureExtractorContract

DIM, DEPTH, SIDE = 128, 2, 5


def hub_layout(registers=0):
    """Random tensors under the names of ``dinov2_vits14_pretrain.pth``, smaller."""
    g = torch.Generator().manual_seed(0)
    make = lambda *shape: torch.randn(*shape, generator=g) * 0.2  # noqa: E731
    tensors = {
        "cls_token": make(1, 1, DIM),
        "pos_embed": make(1, 1 + SIDE * SIDE, DIM),
        "mask_token": make(1, DIM),
        "patch_embed.proj.weight": make(DIM, 3, 14, 14),
        "patch_embed.proj.bias": make(DIM),
        "norm.weight": 1 + make(DIM),
        "norm.bias": make(DIM),
    }
    if registers:
        tensors["register_tokens"] = make(1, registers, DIM)
    for i in range(DEPTH):
        b = f"blocks.{i}"
        for norm in ("norm1", "norm2"):
            tensors |= {f"{b}.{norm}.weight": 1 + make(DIM), f"{b}.{norm}.bias": make(DIM)}
        tensors |= {f"{b}.attn.qkv.weight": make(3 * DIM, DIM), f"{b}.attn.qkv.bias": make(3 * DIM)}
        tensors |= {f"{b}.attn.proj.weight": make(DIM, DIM), f"{b}.attn.proj.bias": make(DIM)}
        tensors |= {f"{b}.mlp.fc1.weight": make(4 * DIM, DIM), f"{b}.mlp.fc1.bias": make(4 * DIM)}
        tensors |= {f"{b}.mlp.fc2.weight": make(DIM, 4 * DIM), f"{b}.mlp.fc2.bias": make(DIM)}
        tensors |= {f"{b}.ls1.gamma": make(DIM), f"{b}.ls2.gamma": make(DIM)}
    return tensors


def reference(t, images, registers=0):
    """The transformer as plain arithmetic, attention by explicit softmax, on its training grid."""
    norm = lambda x, name: functional.layer_norm(x, (DIM,), t[f"{name}.weight"], t[f"{name}.bias"], 1e-6)  # noqa: E731
    linear = lambda x, name: x @ t[f"{name}.weight"].T + t[f"{name}.bias"]  # noqa: E731
    x = functional.conv2d(images, t["patch_embed.proj.weight"], t["patch_embed.proj.bias"], stride=14)
    x = torch.cat([t["cls_token"], x.flatten(2).transpose(1, 2)], 1) + t["pos_embed"]
    if registers:
        x = torch.cat([x[:, :1], t["register_tokens"], x[:, 1:]], 1)
    for i in range(DEPTH):
        b = f"blocks.{i}"
        q, k, v = linear(norm(x, f"{b}.norm1"), f"{b}.attn.qkv").split(DIM, -1)
        heads = []
        for h in range(DIM // 64):
            part = slice(64 * h, 64 * h + 64)
            weights = (q[..., part] @ k[..., part].transpose(1, 2) / 8.0).softmax(-1)
            heads.append(weights @ v[..., part])
        x = x + t[f"{b}.ls1.gamma"] * linear(torch.cat(heads, -1), f"{b}.attn.proj")
        y = functional.gelu(linear(norm(x, f"{b}.norm2"), f"{b}.mlp.fc1"))
        x = x + t[f"{b}.ls2.gamma"] * linear(y, f"{b}.mlp.fc2")
    return norm(x, "norm")[:, 1 + registers :].transpose(1, 2).reshape(1, DIM, SIDE, SIDE)


@pytest.mark.parametrize("registers", [0, 4])
def test_the_transformer_computes_what_the_checkpoint_means(tmp_path, registers):
    tensors = hub_layout(registers)
    torch.save(tensors, tmp_path / "vit.pth")
    model = load_transformer(tmp_path / "vit.pth").eval()
    images = torch.randn(1, 3, SIDE * 14, SIDE * 14, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        assert torch.allclose(model(images), reference(tensors, images, registers), atol=1e-3)
        assert model(torch.randn(1, 3, 42, 70)).shape == (1, DIM, 3, 5)


@pytest.mark.slow
class TestDinoV2(FeatureExtractorContract):
    @pytest.fixture
    def make_plugin(self, tmp_path):
        torch.save(hub_layout(), tmp_path / "vit.pth")
        return lambda: DinoV2(str(tmp_path / "vit.pth"), image_size=[112, 140], proposals=30)


def test_the_extractor_describes_regions(tmp_path):
    torch.set_num_threads(1)
    torch.save(hub_layout(), tmp_path / "vit.pth")
    extractor = DinoV2(str(tmp_path / "vit.pth"), image_size=[112, 140], proposals=30)
    image = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    features = extractor.extract(image)
    assert len(features.proposals) <= 30
    boxes = torch.tensor([[20.0, 30.0, 100.0, 120.0], [0.0, 0.0, 320.0, 240.0]])
    assert extractor.region_dim == 4 * DIM
    regions = extractor.region_features(features, boxes)
    assert regions.shape == (2, 4 * DIM)
    assert extractor.mask_features(features, boxes).shape == (2, 14, 14, DIM)
    assert extractor.mask_probabilities(features, boxes).shape == (2, 14, 14)
    assert extractor.refined_boxes(features, boxes).shape == (2, 4)
    again = extractor.extract(image)
    assert torch.equal(extractor.region_features(again, boxes), regions)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(WeightsError, match="no weight file"):
        DinoV2(str(tmp_path / "none.pth"))
    torch.save({"x": torch.zeros(1)}, tmp_path / "x.pth")
    with pytest.raises(WeightsError, match="names of a DINOv2"):
        DinoV2(str(tmp_path / "x.pth"))
    wrong = hub_layout()
    wrong["blocks.1.mlp.fc1.bias"] = torch.zeros(3)
    torch.save(wrong, tmp_path / "wrong.pth")
    with pytest.raises(WeightsError, match=r"'blocks.1.mlp.fc1.bias' has shape \(3,\)"):
        DinoV2(str(tmp_path / "wrong.pth"))
