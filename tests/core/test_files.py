import errno
import json

import pytest

from icub_benchmarks.figures import Figure, write_results
from icub_core.errors import CheckpointError
from icub_core.files import write_atomically, write_text_atomically


def test_a_full_disk_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "weights.bin"
    write_text_atomically(path, "old")

    def fill_the_disk(temporary):
        temporary.write_text("half of the ne")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(CheckpointError, match="No space left on device"):
        write_atomically(path, fill_the_disk)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_results_keep_other_figures_with_their_own_command(tmp_path):
    path = tmp_path / "simulation.json"
    write_results(path, command="first", seed=1, figures={"a.x": Figure(1.0, "s")})
    write_results(path, command="second", seed=2, figures={"a.y": Figure(2.0, "1", spread=(1.5, 2.5), n=3)})
    content = json.loads(path.read_text())
    assert content["command"] == "second"
    assert content["figures"]["a.x"]["command"] == "first"
    assert content["figures"]["a.y"] == {"value": 2.0, "unit": "1", "spread": [1.5, 2.5], "n": 3}
    assert set(content["machine"]) == {"cores", "gpu"}
