"""Weight files: written in one step, read back exactly, refused in one line."""

import pytest
import torch
from torch import nn

from icub_core.errors import CheckpointError, WeightsError
from icub_support import weights


def test_tensors_and_header_come_back_as_they_were(tmp_path):
    file = tmp_path / "w.safetensors"
    tensors = {"a.x": torch.arange(6.0).view(2, 3).T, "a.y": torch.tensor(3), "b.x": torch.ones(2, dtype=torch.half)}
    weights.write_tensors(file, tensors, {"about": '{"classes": 2}'})
    found, header = weights.read_tensors(file)
    assert all(torch.equal(found[name], tensors[name]) for name in tensors)
    assert weights.entry(header, "about", file) == {"classes": 2}
    assert set(weights.part(found, "a")) == {"x", "y"}
    assert weights.with_prefix("a", weights.part(found, "a")).keys() == {"a.x", "a.y"}
    with pytest.raises(CheckpointError, match="no entry 'labels'"):
        weights.entry(header, "labels", file)


def test_a_missing_or_truncated_file_is_named_in_one_line(tmp_path):
    file = tmp_path / "w.safetensors"
    with pytest.raises(WeightsError, match=r"no file .*w\.safetensors"):
        weights.read_tensors(file, WeightsError)
    weights.write_tensors(file, {"a": torch.ones(100)})
    file.write_bytes(file.read_bytes()[:-4])
    with pytest.raises(CheckpointError, match=r"w\.safetensors is truncated") as error:
        weights.read_tensors(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("library", [OSError(28, "No space left on device"), weights.SafetensorError("No space left")])
def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch, library):
    file = tmp_path / "w.safetensors"
    weights.write_tensors(file, {"a": torch.ones(2)})
    old = file.read_bytes()

    def full(*_):
        raise library

    monkeypatch.setattr(weights, "save_file", full)
    with pytest.raises(CheckpointError, match="No space left"):
        weights.write_tensors(file, {"a": torch.zeros(9)})
    assert file.read_bytes() == old
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("bias"), r"lacks 'bias' \(2,\): it is of another architecture"),
        (lambda t: t.update(bias=torch.zeros(3)), r"'bias' has shape \(3,\), expected \(2,\)"),
        (lambda t: t.update(bias=torch.full((2,), float("nan"))), "'bias' holds NaN"),
        (lambda t: t.update(more=torch.zeros(1)), "holds 'more', which this architecture lacks"),
    ],
)
def test_tensors_of_another_architecture_are_refused_and_change_nothing(change, message):
    layer = nn.Linear(3, 2)
    before = {name: value.clone() for name, value in layer.state_dict().items()}
    tensors = {name: value + 1 for name, value in before.items()}
    change(tensors)
    with pytest.raises(WeightsError, match=message):
        weights.fill(layer, tensors, "file")
    assert all(torch.equal(value, before[name]) for name, value in layer.state_dict().items())


def test_a_training_that_loads_the_state_of_adam_goes_on_as_if_never_stopped():
    def trained(steps, resumed_after=None):
        torch.manual_seed(0)
        layer = nn.Conv2d(4, 4, 3).to(memory_format=torch.channels_last)
        optimizer = torch.optim.AdamW(layer.parameters(), lr=0.1, fused=True)
        for step in range(steps):
            if step == resumed_after:
                state = weights.adam_state(optimizer)
                optimizer = torch.optim.AdamW(layer.parameters(), lr=0.1, fused=True)
                weights.load_adam_state(optimizer, state)
            optimizer.zero_grad()
            (layer(torch.full((1, 4, 5, 5), step + 1.0)) ** 2).mean().backward()
            optimizer.step()
        return layer.weight

    assert torch.equal(trained(5, resumed_after=3), trained(5))


def test_a_card_is_read_back_and_a_missing_one_is_named(tmp_path):
    weights.write_card(tmp_path / "card.json", {"seed": 1})
    assert weights.read_card(tmp_path / "card.json") == {"seed": 1}
    with pytest.raises(WeightsError, match="no card"):
        weights.read_card(tmp_path / "none.json")
