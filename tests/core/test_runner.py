"""A run: composed once, its stages left out, resumed and reported in one loop, everything closed at its end."""

import json
import logging
from pathlib import Path

import hydra
import pytest
import yaml

from icub_core.cli import main
from icub_core.config import compose as composing
from icub_core.config.compose import compose
from icub_core.errors import DataError
from icub_core.hooks import Events, listen
from icub_core.interfaces.pipeline import Stage
from icub_core.run import Run
from icub_core.runner import carry_out, do_stages
from icub_testing.tiny import TINY

WORDS = [f"{kind}=tiny" for kind in ("pipeline", "task", "simulator", "robot", "objects", "grasp_generator")]
LONGER = '''
from icub_core.interfaces.pipeline import Stage
from icub_testing.tiny.pipeline import TinyPipeline
class Longer(TinyPipeline):
    """Counts, checks, and says goodbye."""
    def __init__(self, steps: int = 3, farewell: str = "bye"):
        super().__init__(steps)
        self._farewell = farewell
    def stages(self, run):
        return (*super().stages(run), Stage("farewell", self._do_farewell))
    def _do_farewell(self, run):
        run.record({"farewell.word": self._farewell})
'''


@pytest.fixture
def tiny(install, tmp_path, monkeypatch):
    points = {f"icub.{kind}": {"tiny": target} for kind, target in TINY.items()}
    points["icub.pipeline"]["longer"] = "longer_module:Longer"
    install("tiny", points, {"longer_module.py": LONGER})
    monkeypatch.chdir(tmp_path)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level


def figures(folder: str) -> dict:
    return json.loads(Path(folder, "metrics.json").read_text())


def test_a_run_is_composed_once_and_leaves_everything_in_its_folder(tiny, monkeypatch):
    calls = []
    for owner, name in ((composing, "compose"), (hydra, "compose")):
        original = getattr(owner, name)

        def counted(*args, _original=original, _name=f"{owner.__name__}.{name}", **options):
            calls.append(_name)
            return _original(*args, **options)

        monkeypatch.setattr(owner, name, counted)
    assert main(["run", *WORDS, "pipeline.steps=4", "seed=3", "run_dir=here"]) == 0
    assert sorted(calls) == ["hydra.compose", "icub_core.config.compose.compose"]
    names = {str(path.relative_to("here")) for path in Path("here").rglob("*") if path.is_file()}
    assert {
        "config.yaml", ".hydra/overrides.yaml", "run.log", "provenance.json", "metrics.json", "report.html",
        "done_count.json", "done_verify.json", "done_name.json",
    } <= names  # fmt: skip
    written = yaml.safe_load(Path("here/config.yaml").read_text())
    assert (written["pipeline"], written["seed"]) == ({"plugin": "tiny", "steps": 4}, 3)
    assert yaml.safe_load(Path("here/.hydra/overrides.yaml").read_text())[-1] == "run_dir=here"
    assert json.loads(Path("here/provenance.json").read_text())["seed"] == 3
    assert figures("here")["count.steps"] == 4
    assert {"count.seconds", "verify.seconds", "name.seconds", "run.seconds"} <= set(figures("here"))
    report = Path("here/report.html").read_text()
    assert "count.steps" in report
    assert "steps: 4" in report
    assert "stage count took" in Path("here/run.log").read_text()


def test_a_stage_whose_kind_is_not_chosen_is_left_out_and_the_reader_is_told(tiny):
    left_out = [word for word in WORDS if not word.startswith(("robot", "grasp_generator"))]
    assert main(["run", *left_out, "~robot", "~grasp_generator", "run_dir=here"]) == 0
    assert not Path("here/done_name.json").exists()
    assert "name.robot" not in figures("here")
    assert "no robot was chosen: nothing is named" in Path("here/report.html").read_text()


def test_a_pipeline_of_a_third_party_adds_a_stage_through_an_entry_point(tiny):
    words = [word for word in WORDS if not word.startswith("pipeline")]
    assert main(["run", *words, "pipeline=longer", "pipeline.farewell=ciao", "run_dir=here"]) == 0
    assert figures("here")["count.steps"] == 3
    assert figures("here")["farewell.word"] == "ciao"
    assert Path("here/done_farewell.json").exists()


def test_a_finished_run_is_resumed_without_doing_anything_again(tiny):
    assert main(["run", *WORDS, "run_dir=here"]) == 0
    before = figures("here")
    Path("here/count.txt").write_text("999")  # whoever counts again writes 3, whoever verifies again finds it wrong
    assert main(["run", "--resume", "here"]) == 0
    after = figures("here")
    assert Path("here/count.txt").read_text() == "999"
    assert after["verify.right"] is True
    assert {k: v for k, v in after.items() if k != "run.seconds"} == {
        k: v for k, v in before.items() if k != "run.seconds"
    }


def test_a_stage_that_cannot_be_resumed_is_done_again_and_so_is_everything_after_it(tiny):
    assert main(["run", *WORDS, "run_dir=here"]) == 0
    Path("here/count.txt").unlink()  # the stage `count` then has nothing to resume from
    Path("here/done_verify.json").write_text(Path("here/done_verify.json").read_text().replace("true", "false"))
    assert main(["run", "--resume", "here"]) == 0
    assert Path("here/count.txt").read_text() == "3"
    assert figures("here")["verify.right"] is True, "what followed belongs to another past"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"metrics": {}}', '{"metrics": 3, "seconds": {}, "notes": []}'])
def test_a_damaged_record_is_one_line_that_says_what_to_do(tiny, capsys, content):
    assert main(["run", *WORDS, "run_dir=here"]) == 0
    Path("here/done_verify.json").write_text(content)
    capsys.readouterr()
    assert main(["run", "--resume", "here"]) == 1
    error = capsys.readouterr().err
    assert "done_verify.json is damaged; delete it to do the stage 'verify' again" in error
    (line,) = [line for line in error.splitlines() if not line.startswith("run folder:")]
    assert line.startswith("icub: error: ")
    Path("here/done_verify.json").unlink()
    assert main(["run", "--resume", "here"]) == 0


class Everything:
    """Plugins of a run, all of them chosen."""

    def chosen(self, kind):
        return "tiny"

    def choose(self, kind, name): ...

    def get(self, kind): ...

    def fresh(self, kind, **given): ...


def a_run(folder, *listeners, seed=3) -> Run:
    return Run(folder, seed, Events(listeners), Everything())


class Listener:
    def __init__(self):
        self.heard = []

    @listen
    def icub_progress(self, stage, fraction, text):
        self.heard.append((stage, fraction, text))

    @listen
    def icub_stage_start(self, stage):
        self.heard.append((stage, "start"))

    @listen
    def icub_stage_end(self, stage, seconds):
        self.heard.append((stage, "end"))


def test_stages_are_timed_listeners_told_and_what_is_finished_recalled(tmp_path):
    def see(run):
        run.progress(0.5, "half")
        run.record({"segmentation.map50_segm": 0.8})
        run.note("few images")
        run.images.append(("Found", run.run_dir / "found.png"))

    def grasp(run):
        raise DataError("no hand")

    listener = Listener()
    run = a_run(tmp_path, listener)
    with pytest.raises(DataError, match="no hand"):
        do_stages(run, (Stage("see", see), Stage("grasp", grasp)))
    assert listener.heard == [
        ("see", "start"), ("see", 0.5, "half"), ("see", "end"), ("grasp", "start"), ("grasp", "end"),
    ]  # fmt: skip
    resumed, again = a_run(tmp_path), []
    do_stages(resumed, (Stage("see", again.append), Stage("grasp", again.append)))
    assert again == [resumed], "what was not finished is done, what was finished is not"
    assert resumed.metrics["segmentation.map50_segm"] == 0.8
    assert resumed.metrics["see.seconds"] == resumed.seconds["see"] == run.seconds["see"]
    assert resumed.notes == ["few images"]
    assert resumed.images == [("Found", tmp_path / "found.png")]


def test_streams_depend_on_seed_and_purpose_only(tmp_path):
    run = a_run(tmp_path)
    first = run.rng("teach").random()
    run.rng("see").random()
    assert run.rng("teach").random() == first
    assert a_run(tmp_path, seed=4).rng("teach").random() != first


CLOSING = """
from icub_core.interfaces.pipeline import Pipeline, Stage
from icub_testing.tiny.simulator import TinySimulator
CLOSED = []
class Held:
    def __init__(self, name, error=None):
        self.name, self.error = name, error
    def close(self):
        CLOSED.append(self.name)
        if self.error is not None:
            raise self.error
class Closing(TinySimulator):
    def close(self):
        CLOSED.append("simulator")
class Holds(Pipeline):
    def __init__(self, breaks: bool = False, jams: bool = False):
        self._breaks, self._jams = breaks, jams
    def stages(self, run):
        return (Stage("hold", self._hold),)
    def _hold(self, run):
        run.plugins.get("simulator")
        first = run.shared("first", lambda: Held("first"))
        run.shared("second", lambda: Held("second", OSError("jammed") if self._jams else None))
        run.shared("open", lambda: "nothing to close")
        assert run.shared("first", lambda: 1 / 0) is first
        if self._breaks:
            raise ValueError("broken")
"""


@pytest.mark.parametrize(
    ("words", "error"), [([], None), (["pipeline.breaks=true"], ValueError), (["pipeline.jams=true"], OSError)]
)
def test_what_is_shared_is_closed_at_the_end_whatever_happened(tiny, install, tmp_path, words, error):
    points = {
        "icub.pipeline": {"holds": "closing_module:Holds"},
        "icub.simulator": {"closing": "closing_module:Closing"},
    }
    install("closing", points, {"closing_module.py": CLOSING})
    config = compose([*WORDS, "pipeline=holds", "simulator=closing", *words])
    if error is None:
        carry_out(config, tmp_path)
    else:
        with pytest.raises(error):
            carry_out(config, tmp_path)
    import closing_module

    assert closing_module.CLOSED == ["second", "first", "simulator"]
