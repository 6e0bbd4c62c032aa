"""The example plugin, built and installed as a third party would, works without any change here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "third_party_plugin"

LIGHT = ["~simulator", "~robot", "~objects"]
"""Leaves out what takes seconds to import and does not matter here."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> dict[str, str]:
    """Install the example into a folder of its own; returns the environment in which it is found."""
    target = tmp_path_factory.mktemp("site")
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--no-build-isolation", "--no-index", "--target", str(target), str(EXAMPLE),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(target), os.environ.get("PYTHONPATH", "")])}


def _icub(environment: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "icub_core.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def _add_broken(environment: dict[str, str], folder: Path) -> dict[str, str]:
    """Add a distribution whose every promise fails when it is used."""
    info = folder / "broken_plugin-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-plugin\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[icub.grasp_generator]\nbroken = broken_plugin:Broken\n[icub.hooks]\nbroken = broken_plugin\n"
        "[icub.configs]\nbroken = broken_configs\n"
    )
    (folder / "broken_plugin.py").write_text("import a_library_that_is_not_there\n")
    return {**environment, "PYTHONPATH": os.pathsep.join([str(folder), environment["PYTHONPATH"]])}


def test_it_is_listed_with_its_description(installed):
    done = _icub(installed, "plugins", "list", "grasp_generator")
    assert done.returncode == 0, done.stderr
    line = next(row for row in done.stdout.splitlines() if " top_down " in row)
    assert "The palm straight down onto the middle of the object" in line
    assert line.endswith("icub-top-down 0.1.0")


def test_its_signature_is_its_configuration(installed):
    done = _icub(installed, "run", *LIGHT, "grasp_generator=top_down", "grasp_generator.clearance=0.03", "--cfg", "job")
    assert done.returncode == 0, done.stderr
    assert "grasp_generator:\n  plugin: top_down\n  clearance: 0.03\n" in done.stdout
    done = _icub(installed, "run", *LIGHT, "grasp_generator=top_down", "grasp_generator.clearence=0.03")
    assert done.returncode == 2
    assert "has no parameter 'clearence'. Did you mean 'clearance'?" in done.stderr


@pytest.mark.slow
def test_it_keeps_its_contract_on_the_command_line(installed):
    done = _icub(installed, "plugins", "check", "grasp_generator", "top_down")
    assert done.returncode == 0, done.stdout + done.stderr


def test_its_own_tests_pass(installed):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, str(EXAMPLE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=installed, cwd=EXAMPLE)
    assert done.returncode == 0, done.stdout


def test_it_is_about_twenty_lines():
    code = [line for line in (EXAMPLE / "icub_top_down.py").read_text().splitlines() if line.strip()]
    begin = next(i for i, line in enumerate(code) if "def __init__" in line)
    assert len(code) - begin <= 24


def test_a_broken_neighbor_does_not_disturb_it(installed, tmp_path):
    environment = _add_broken(installed, tmp_path / "broken")
    done = _icub(environment, "plugins", "list", "grasp_generator")
    assert done.returncode == 0
    assert {"broken", "top_down"} <= {row.split()[1] for row in done.stdout.splitlines()}
    assert _icub(environment, "run", *LIGHT, "grasp_generator=top_down", "--cfg", "job").returncode == 0
    done = _icub(environment, "run", *LIGHT, "grasp_generator=broken")
    assert done.returncode == 2
    (line,) = [row for row in done.stderr.splitlines() if row.startswith("icub: error")]
    assert "broken_plugin:Broken, from broken-plugin 1.0" in line
    assert "No module named 'a_library_that_is_not_there'" in line
    assert "Traceback" not in done.stderr
