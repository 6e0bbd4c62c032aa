"""`icub benchmark`: every benchmark is announced, has one command line, and writes into a folder of its own."""

import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

from icub_benchmarks import cli, compare
from icub_benchmarks import command as benchmark
from icub_benchmarks.figures import Figure
from icub_benchmarks.results import RUNS, command_line, make_parser, write_figures
from icub_core.errors import DataError

NAMES = (
    "cli", "compare", "environment", "features", "grasping", "grasps", "heads", "incremental", "kinematics", "main_job",
    "segmentation", "simulation", "superquadrics", "vgn",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_every_benchmark_says_how_it_is_called_and_takes_arguments_from_the_caller_alone(name, capsys):
    main = benchmark.benchmarks()[name].load()
    assert list(inspect.signature(main).parameters) == ["argv"]
    assert benchmark.main([name, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: icub benchmark {name} ")
    assert benchmark.main([name, "--no-such-option"]) == 2


def test_benchmarks_run_outside_of_a_checkout_and_write_there(tmp_path):
    command = [sys.executable, "-m", "icub_core.cli", "benchmark", "superquadrics", "--views", "1"]
    subprocess.run(command, check=True, cwd=tmp_path, capture_output=True)
    (file,) = (tmp_path / RUNS / "superquadrics").glob("*/grasps.json")
    content = json.loads(file.read_text())
    assert content["command"] == "icub benchmark superquadrics --views 1 --seed 0"
    assert "superquadrics.fit_ms" in content["figures"]


def test_results_go_into_the_folder_that_is_named_and_keep_what_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cli, "COMMANDS", {"cli.version_s": ["--version"]})
    write_figures(tmp_path / "cli.json", {"cli.other": Figure(1.0, "s")}, command="icub benchmark cli")
    cli.main(["--repetitions", "2", "--results", str(tmp_path)])
    content = json.loads((tmp_path / "cli.json").read_text())
    assert content["command"] == "icub benchmark cli --repetitions 2"
    assert set(content["figures"]) == {"cli.other", "cli.version_s"}
    assert f"written: {tmp_path / 'cli.json'}" in capsys.readouterr().out


def test_the_command_leaves_out_where_results_are_written():
    assert command_line("heads", ["--results", "x", "--seed", "1"]) == "icub benchmark heads --seed 1"
    assert command_line("heads", ["--seed", "1", "--results=x"]) == "icub benchmark heads --seed 1"


def test_a_results_file_is_refused_where_a_folder_is_expected(capsys):
    with pytest.raises(SystemExit):
        make_parser("heads", None).parse_args(["--results", "somewhere/heads.json"])
    assert "is a file; expected a folder, such as somewhere" in capsys.readouterr().err


def written(path: Path, **figures: Figure) -> str:
    write_figures(path, figures, command="icub benchmark x")
    return str(path)


def test_two_results_are_compared_figure_by_figure(tmp_path, capsys):
    a = written(
        tmp_path / "a" / "x.json", same=Figure(0.5, "1", n=3), share=Figure(0.5, "1"), slow=Figure(1.0, "s"),
        fast=Figure(1.0, "ms"), rate=Figure(10.0, "1/s"), fewer=Figure(1.0, "1", n=9), only_a=Figure(1.0, "1"),
    )  # fmt: skip
    b = written(
        tmp_path / "b" / "x.json", same=Figure(0.5, "1", n=3), share=Figure(0.25, "1"), slow=Figure(1.5, "s"),
        fast=Figure(1.1, "ms"), rate=Figure(5.0, "1/s"), fewer=Figure(1.0, "1", n=8), only_b=Figure(1.0, "1"),
    )  # fmt: skip
    capsys.readouterr()
    assert compare.main([a, a]) == 0
    assert "7 of 7" in capsys.readouterr().out
    for first, second in ((a, b), (str(tmp_path / "a"), str(tmp_path / "b"))):
        assert compare.main([first, second]) == 1
        out = capsys.readouterr().out
        assert "2 of 6" in out
        rows = {words[1]: " ".join(words) for words in map(str.split, out.splitlines()) if len(words) > 2}
        assert "-0.25" in rows["share"]
        assert "50% slower" in rows["slow"]
        assert "100% slower" in rows["rate"]
        assert "n 9, 8" in rows["fewer"]
        assert not {"same", "fast", "only_a", "only_b"} & set(rows)


def test_what_cannot_be_compared_is_one_line(tmp_path):
    a = written(tmp_path / "a" / "x.json", share=Figure(0.5, "1"))
    (tmp_path / "notes.json").write_text("[]")
    (tmp_path / "b").mkdir()
    for second, message in (("nowhere", "not there"), ("notes.json", "no results file")):
        with pytest.raises(DataError, match=message):
            compare.main([a, str(tmp_path / second)])
    with pytest.raises(DataError, match="same name"):
        compare.main([str(tmp_path / "a"), str(tmp_path / "b")])


def test_a_benchmark_that_stops_with_a_message_shows_it(monkeypatch, capsys):
    class Stops:
        value = "somewhere:main"

        def load(self):
            return lambda argv: sys.exit("no such folder")

    monkeypatch.setattr(benchmark, "benchmarks", lambda: {"stops": Stops()})
    assert benchmark.main(["stops"]) == 1
    assert capsys.readouterr().err == "no such folder\n"
