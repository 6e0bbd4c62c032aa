"""The command line: light to start, one line for every mistake, runs that can be continued."""

import json
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from icub_core import __version__
from icub_core.cli import main
from icub_core.commands.installed import commands_by_name
from icub_core.errors import DataError, IcubError
from icub_support.commands.completion import SCRIPTS, candidates
from icub_testing.tiny import TINY

HEAVY = {
    "torch",
    "numpy",
    "hydra",
    "omegaconf",
    "mujoco",
    "pybullet",
    "pinocchio",
    "torchvision",
    "rich",
    "pytest",
    "yaml",
}
WORLD = ["simulator=tiny", "robot=tiny", "objects=tiny", "grasp_generator=tiny"]


@pytest.fixture
def tiny(install):
    return install("tiny", {f"icub.{kind}": {"tiny": target} for kind, target in TINY.items()})


@pytest.fixture
def runs(tiny, tmp_path, monkeypatch):
    """Replace what carries out a run by a record of what it was given; `runs.does` says what it then does."""

    class Runs(list):
        does = staticmethod(lambda config, run_dir: {"figure": 1.0})

    recorded = Runs()

    def run(config, run_dir, listeners=()):
        recorded.append((config, run_dir))
        return recorded.does(config, run_dir)

    monkeypatch.setattr("icub_core.runner.carry_out", run)
    monkeypatch.chdir(tmp_path)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield recorded
    root.handlers[:], root.level = handlers, level


def _python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, **environment}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=variables, check=False)


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["--version"],
        ["plugins", "list"],
        ["plugins", "list", "--markdown"],
        ["_complete", "icub", "run", "pol"],
    ],
)
def test_light_commands_import_nothing_heavy(words):
    code = f"""
import sys
from icub_core.cli import main
try:
    main({words!r})
except SystemExit as end:
    assert not end.code
heavy = {HEAVY!r} & set(sys.modules)
assert not heavy, heavy
assert not [m for m in sys.modules if m.startswith("icub_") and not m.startswith(("icub_core", "icub_support"))]
"""
    done = _python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert not end.value.code
    text = capsys.readouterr().out
    assert {"run", "train", "benchmark", "plugins", "completion"} <= set(commands_by_name())
    assert all((command in text) is not command.startswith("_") for command in commands_by_name())


def test_a_third_party_s_command_is_listed_and_run_and_a_broken_one_is_one_line(install, capsys):
    source = 'def main(words):\n    """Say what was typed."""\n    print(*words)\n    return 7\n'
    install(
        "echoing",
        {"icub.command": {"echo": "echo_module:main", "broken": "no_module:main"}},
        {"echo_module.py": source},
    )
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "echo        Say what was typed" in capsys.readouterr().out
    assert main(["echo", "a", "--b"]) == 7
    assert capsys.readouterr().out == "a --b\n"
    assert main(["broken"]) == 2
    error = capsys.readouterr().err
    assert "the command 'broken' (no_module:main) cannot be imported: No module named 'no_module'" in error
    assert error.count("\n") == 1


def test_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"icub {__version__}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rnu"], "no command named 'rnu'. Did you mean 'run'?"),
        (["run", "+segmentr=tiny"], "Did you mean 'segmenter=tiny'?"),
        (["run", "policy=tini"], "no policy plugin named 'tini'. Did you mean 'tiny'?"),
        (["run", "policy=tiny", "policy.spede=1"], "policy 'tiny' has no parameter 'spede'. Did you mean 'speed'?"),
        (["run", "device=cuda:77"], "device=cuda:77 cannot be used: "),
        (["run", "device=gpu"], "device=gpu cannot be used: "),
        (["run", "--resume"], "--resume needs the folder of a run"),
        (["run", "--resume", "nowhere"], "nowhere is not the folder of a run"),
        (["run", "--config-dir", "nowhere"], "the configuration folder 'nowhere' does not exist"),
        (["train", "policy"], "'policy' is not KIND=NAME"),
        (["train", "robot=tiny"], "nothing to train: no training named 'robot=tiny'. "),
        (["train", "policy=gpain"], "no policy plugin named 'gpain'. Did you mean 'gpayn'?"),
        (["train", "policy=gpayn", "--minutes", "0"], "--minutes 0.0 is not above 0"),
        (["train", "robot=tini"], "Did you mean 'tiny'?"),
        (["benchmark", "nothing"], "no benchmark named 'nothing'"),
        (["plugins", "list", "robbot"], "no plugin kind named 'robbot'. Did you mean 'robot'?"),
        (["plugins", "show", "tini"], "no plugin named 'tini'. Did you mean 'tiny'?"),
        (["plugins", "show", "robot", "tini"], "no robot plugin named 'tini'. Did you mean 'tiny'?"),
        (["plugins", "check", "robot", "tini"], "no robot plugin named 'tini'. Did you mean 'tiny'?"),
        (["plugins", "check", "policy", "tiny", "--set", "spede=1"], "Did you mean 'speed'?"),
        (["plugins", "check", "policy", "tiny", "--set", "speed"], "'speed' is not PARAMETER=VALUE"),
    ],
)
def test_mistakes_are_told_in_one_line_with_exit_code_2(runs, capsys, words, message):
    code = main(["run", *WORLD, *words[1:]] if words[0] == "run" else words)
    error = capsys.readouterr().err
    assert code == 2
    assert error.startswith("icub: error: ")
    assert message in error
    assert error.count("\n") == 1
    assert not runs
    assert not Path("runs").exists(), "no run folder for a run that cannot begin"


def test_a_run_is_carried_out_in_its_own_folder(runs, capsys):
    assert main(["run", *WORLD, "+policy=tiny", "policy.speed=0.25", "seed=3"]) == 0
    ((config, run_dir),) = runs
    assert config.policy == {"plugin": "tiny", "speed": 0.25}
    assert run_dir.is_dir()
    assert run_dir.parent.parent == Path("runs").resolve()
    written = yaml.safe_load((run_dir / "config.yaml").read_text())
    assert written["seed"] == 3
    assert written["policy"]["speed"] == 0.25
    assert Path(written["run_dir"]) == run_dir
    assert (run_dir / "run.log").exists()


def test_the_folder_of_a_run_can_be_chosen(runs):
    assert main(["run", *WORLD, "run_dir=here/it is"]) == 0
    assert runs[0][1] == Path("here/it is").resolve()


def test_a_sweep_runs_every_combination_in_its_own_folder(runs):
    assert main(["run", "-m", *WORLD, "+policy=tiny", "policy.speed=0.1,0.2", "seed=1,2"]) == 0
    assert sorted((c.policy.speed, c.seed) for c, _ in runs) == [(0.1, 1), (0.1, 2), (0.2, 1), (0.2, 2)]
    assert len({run_dir for _, run_dir in runs}) == 4


def test_a_sweep_over_plugins_and_over_nothing(runs):
    assert main(["run", "--multirun", *WORLD, "+policy=tiny,null"]) == 0
    assert [c.policy and c.policy.plugin for c, _ in runs] == ["tiny", None]


def test_a_misspelt_choice_in_a_sweep_stops_it_before_it_begins(runs, capsys):
    assert main(["run", "-m", *WORLD, "policy=tiny,tini"]) == 2
    assert "Did you mean 'tiny'?" in capsys.readouterr().err
    assert not runs


def test_a_job_that_fails_does_not_stop_the_rest_of_a_sweep(runs):
    def does(config, run_dir):
        if config.seed == 1:
            raise DataError("the first one fails")
        return {}

    runs.does = does
    assert main(["run", "-m", *WORLD, "seed=1,2"]) == 1
    assert [config.seed for config, _ in runs] == [1, 2]


def _raise(error):
    def does(config, run_dir):
        raise error

    return does


def test_an_expected_failure_of_a_run_is_one_line_and_exit_code_1(runs, capsys):
    runs.does = _raise(DataError("the mesh 'x.obj' has no faces"))
    assert main(["run", *WORLD]) == 1
    captured = capsys.readouterr()
    assert captured.err == "icub: error: the mesh 'x.obj' has no faces\n"


def test_a_traceback_is_shown_when_it_is_asked_for(runs, monkeypatch):
    monkeypatch.setenv("ICUB_DEBUG", "1")
    runs.does = _raise(DataError("the mesh 'x.obj' has no faces"))
    with pytest.raises(IcubError, match="no faces"):
        main(["run", *WORLD])


def test_a_defect_is_not_hidden(runs):
    runs.does = _raise(ZeroDivisionError("a defect"))
    with pytest.raises(ZeroDivisionError):
        main(["run", *WORLD])


def test_an_interrupted_run_says_how_to_resume_and_resumes(runs, capsys):
    runs.does = _raise(KeyboardInterrupt())
    assert main(["run", *WORLD, "+policy=tiny", "policy.speed=0.75"]) == 130
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("icub: interrupted; to resume: icub run --resume runs/")
    words = error.partition("to resume: icub ")[2].split()
    runs.does = lambda config, run_dir: {}
    assert main([*words, "pipeline.grasp.episodes=2"]) == 0
    (_, first), (config, second) = runs
    assert first == second
    assert config.policy.speed == 0.75
    assert config.pipeline.grasp.episodes == 2


def test_a_broken_third_party_plugin_disturbs_neither_lists_nor_runs(runs, install, capsys):
    install(
        "broken",
        {"icub.policy": {"broken": "broken_module:Broken"}, "icub.hooks": {"broken": "nothing:Here"}},
        {"broken_module.py": "1/0"},
    )
    assert main(["plugins", "list", "policy"]) == 0
    assert "broken" in capsys.readouterr().out
    assert main(["run", *WORLD, "policy=tiny"]) == 0
    assert main(["run", *WORLD, "policy=broken"]) == 2
    error = capsys.readouterr().err
    assert "(broken_module:Broken, from broken 1.0) cannot be imported: ZeroDivisionError" in error
    assert error.count("\n") == 1


TRAINED = """
import json, time
from icub_testing.tiny.skills import TinyPolicy
class Trained(TinyPolicy):
    \"\"\"Closes the hand as it was trained to.\"\"\"
def train(run_dir, seed, minutes=7.0, progress=None):
    progress(0.5, "half")
    (run_dir / "weights.json").write_text(json.dumps([seed, minutes]))
    if seed == 99:
        print("training", flush=True)
        time.sleep(60)
"""


@pytest.fixture
def trained(install):
    points = {
        "icub.policy": {"trained": "trained_module:Trained"},
        "icub.train": {"policy.trained": "trained_module:train"},
    }
    return install("trained", points, {"trained_module.py": TRAINED})


def test_training_calls_the_plugin_with_its_own_default_budget(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "policy=trained", "--seed", "3"]) == 0
    assert json.loads(Path("runs/train/policy-trained-seed3/weights.json").read_text()) == [3, 7.0]
    assert main(["train", "+policy=trained", "--minutes", "2", "--run-dir", "elsewhere"]) == 0
    assert json.loads(Path("elsewhere/weights.json").read_text()) == [0, 2.0]


def test_training_that_is_interrupted_says_how_to_resume(trained, tmp_path):
    command = [sys.executable, "-m", "icub_core.cli", "train", "policy=trained", "--seed", "99", "--run-dir", "there"]
    path = os.pathsep.join([str(trained), os.environ.get("PYTHONPATH", "")])
    child = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background shell ignores it
    )
    try:
        deadline = time.monotonic() + 120
        while not (tmp_path / "there" / "weights.json").exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        child.send_signal(signal.SIGINT)
        _, error = child.communicate(timeout=60)
    finally:
        child.kill()
    assert child.returncode == 130
    assert error.strip().splitlines()[-1] == (
        "icub: interrupted; to resume: icub train policy=trained --seed 99 --minutes 7 --run-dir there"
    )


def test_benchmarks_of_the_checkout_and_of_third_parties_are_run(install, tmp_path, capsys):
    marker = tmp_path / "ran"
    source = f"def main(words):\n    open({str(marker)!r}, 'w').write(' '.join(words))\n    return 3\n"
    install("bench", {"icub.benchmark": {"third": "bench_module:main"}}, {"bench_module.py": source})
    assert main(["benchmark", "--help"]) == 0
    assert {"  cli\n", "  third\n"} <= {line + "\n" for line in capsys.readouterr().out.splitlines()}
    assert main(["benchmark", "third", "--repetitions", "2"]) == 3
    assert marker.read_text() == "--repetitions 2"
    assert main(["benchmark", "cli", "--help"]) == 0


def test_plugins_are_listed_with_what_they_are(tiny, capsys):
    assert main(["plugins", "list", "robot"]) == 0
    line = next(row for row in capsys.readouterr().out.splitlines() if row.split()[:2] == ["robot", "tiny"])
    assert "A hand on a gantry, whose inverse kinematics has a closed form" in line
    assert line.endswith("tiny 1.0")


def test_a_plugin_is_shown_with_parameters_and_needs(tiny, capsys):
    assert main(["plugins", "show", "segmenter", "falkon"]) == 0
    text = capsys.readouterr().out
    assert "needs feature_extractor" in text
    assert "segmenter.seed: int = 0" in text
    assert main(["plugins", "show", "tiny"]) == 0
    assert capsys.readouterr().out.count("=tiny ") == len(TINY)


def test_checking_a_good_plugin_gives_0_and_a_bad_one_1(tiny, install, capsys):
    assert main(["plugins", "check", "objects", "tiny"]) == 0
    assert "7 of 7 kept" in capsys.readouterr().out
    source = "from icub_testing.tiny.things import TinyObjects\nclass Bad(TinyObjects):\n    names = ('red', 'red')\n"
    install("bad", {"icub.objects": {"bad": "bad_module:Bad"}}, {"bad_module.py": source})
    assert main(["plugins", "check", "objects", "bad"]) == 1
    text = capsys.readouterr().out
    assert "FAIL" in text
    assert "expected every name once; got a name twice" in text


def test_a_reader_that_goes_away_is_no_error():
    code = "import sys; from icub_core.cli import main; sys.exit(main(['plugins', 'list']))"
    done = subprocess.run(
        f'{sys.executable} -c "{code}" | head -n 1; exit ${{PIPESTATUS[0]}}', shell=True, executable="/bin/bash",
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("icub ", {"run", "train", "plugins"}),
        ("icub pl", {"plugins"}),
        ("icub run pol", {"policy="}),
        ("icub run +pol", {"+policy="}),
        ("icub run policy=t", {"policy=tiny"}),
        ("icub run +policy=t", {"+policy=tiny"}),
        ("icub run --res", {"--resume"}),
        ("icub run scene=", {"scene=tabletop"}),
        ("icub train robot=t", {"robot=tiny"}),
        ("icub plugins sh", {"show"}),
        ("icub plugins show tin", {"tiny"}),
        ("icub plugins check robot ti", {"tiny"}),
        ("icub completion f", {"fish"}),
    ],
)
def test_completion_knows_what_is_installed(tiny, line, expected):
    assert expected <= set(candidates(line.split(" ")))


@pytest.mark.parametrize("shell", SCRIPTS)
def test_a_completion_script_is_printed(shell, capsys):
    assert main(["completion", shell]) == 0
    assert "icub _complete" in capsys.readouterr().out


def test_bash_completes_with_the_script(tmp_path):
    bin_folder = Path(sys.executable).parent
    script = f"""
export PATH={bin_folder}:$PATH
eval "$({sys.executable} -m icub_core.cli completion bash)"
COMP_LINE="icub run +segmenter=fal"; COMP_POINT=${{#COMP_LINE}}
_icub; echo "${{COMPREPLY[*]}}"
COMP_LINE="icub run +segm"; COMP_POINT=${{#COMP_LINE}}
_icub 2>/dev/null; echo "${{COMPREPLY[*]}}"
"""
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == ["falkon", "+segmenter="], done.stderr
