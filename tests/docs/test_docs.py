"""What README and docs say exists: files, plugins, parameters, benchmarks, figures, images of a bearable size."""

import json
import re
import shlex
from pathlib import Path

import pytest

from icub_core import registry
from icub_core.commands.benchmark import benchmarks
from icub_core.commands.train import trainer
from icub_core.config.compose import compose
from icub_core.hooks import EVENTS
from icub_core.kinds import KINDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
EXAMPLE = {"top_down"}
"""Plugins of examples/third_party_plugin; a test of the framework installs and runs it."""


def pages():
    return [pytest.param(page, id=page.name) for page in PAGES]


def blocks(text: str, language: str) -> list[str]:
    return [body for tag, body in re.findall(r"^```(\w*)\n(.*?)^```", text, re.M | re.S) if tag == language]


def commands() -> list:
    """Every line of a shell block of the pages, without comments, once."""
    found = {}
    for page in PAGES:
        for block in blocks(page.read_text(), ""):
            for line in block.replace("\\\n", " ").splitlines():
                words = tuple(shlex.split(line, comments=True))
                if words:
                    found.setdefault(words, page.name)
    return [pytest.param(words, id=f"{page}: {' '.join(words)}") for words, page in found.items()]


def of(tool: str) -> list:
    return [case for case in commands() if case.values[0][: len(tool.split())] == tuple(tool.split())]


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", pages())
def test_relative_links_and_images_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(there), f"{page.name} links to {target}; headings: {sorted(anchors(there))}"


@pytest.mark.parametrize("page", pages())
def test_paths_that_are_named_exist(page):
    named = re.findall(r"`((?:core|plugins|configs|docs|tests|examples|benchmarks|script)/[\w./-]+)`", page.read_text())
    for path in named:
        assert (ROOT / path).exists(), f"{page.name} names {path}"


def test_pictures_are_small():
    pictures = list((ROOT / "docs" / "images").iterdir())
    assert pictures
    for picture in pictures:
        limit = 1_500_000 if picture.suffix == ".gif" else 150_000
        assert picture.stat().st_size <= limit, f"{picture.name} is {picture.stat().st_size} bytes; at most {limit}"


def test_every_picture_is_shown():
    text = "".join(page.read_text() for page in PAGES)
    for picture in (ROOT / "docs" / "images").iterdir():
        assert f"images/{picture.name}" in text, f"no page shows {picture.name}"


@pytest.mark.parametrize("words", of("icub run"))
def test_runs_compose(words):
    """The composition refuses unknown groups, plugins, keys and types."""
    values = {"--cfg", "--resume", "--config-dir"}
    overrides = [
        word
        for before, word in zip(("", *words[2:]), words[2:], strict=False)
        if not word.startswith("-") and before not in values
    ]
    if any(f"={name}" in word for word in overrides for name in EXAMPLE):
        pytest.skip("needs the example to be installed")
    sweep = any(word in ("-m", "--multirun") for word in words)
    compose([re.sub(r",[^\]]*$", "", word) if sweep else word for word in overrides])


@pytest.mark.parametrize("words", of("icub plugins"))
def test_plugin_commands_name_what_exists(words):
    action, *rest = words[2:]
    rest = [word for word in rest if not word.startswith("--") and "=" not in word]
    if EXAMPLE & set(rest):
        return
    if action == "show":
        assert any(rest[-1] in registry.available(kind) for kind in KINDS)
    elif rest:
        known = registry.available(rest[0])
        assert set(rest[1:]) <= set(known)
    assert action in ("list", "show", "check")


@pytest.mark.parametrize("words", of("icub train"))
def test_trainings_exist(words):
    kind, _, name = words[2].partition("=")
    assert callable(trainer(kind, name))


@pytest.mark.parametrize("page", pages())
def test_benchmarks_exist(page):
    for name in re.findall(r"icub benchmark (\w+)", page.read_text()):
        assert name in (*benchmarks(), "NAME"), f"{page.name} names the benchmark '{name}'"


def test_every_benchmark_is_documented():
    text = (ROOT / "docs" / "reproduce.md").read_text()
    for name in benchmarks():
        assert f"icub benchmark {name}`" in text, f"docs/reproduce.md does not name the benchmark '{name}'"


@pytest.mark.parametrize("page", pages())
def test_python_blocks_are_python(page):
    for block in blocks(page.read_text(), "python"):
        compile(block, page.name, "exec")


def keys_of_a_run() -> set[str]:
    """Literal keys that the code writes into metrics.json."""
    found: set[str] = set()
    for file in (ROOT / "core" / "icub_core").rglob("*.py"):
        found |= set(re.findall(r'f?"((?:run|teach|segmentation|plan|grasp)\.\w+)', file.read_text()))
    names = re.findall(r'"(map\w+)"', (ROOT / "core/icub_core/evaluation/detection.py").read_text())
    return found | {f"segmentation.{name}" for name in names}


@pytest.mark.parametrize("page", pages())
def test_figures_that_are_named_exist(page):
    """A quoted key stands in benchmarks/results or is written by a run."""
    known = keys_of_a_run()
    for file in (ROOT / "benchmarks" / "results").glob("*.json"):
        known |= set(json.loads(file.read_text())["figures"])
    areas = "ik|robot|sim|segmentation|grasp|plan|run|heads|superquadrics|demonstrations|resprect|vgn|validate|cli"
    for key in re.findall(rf"`((?:{areas})\.[a-z0-9_]+)`", page.read_text()):
        if not key.endswith((".json", ".log", ".gif")):
            assert key in known, f"{page.name} quotes {key}, which no result holds"


def test_events_are_all_listed():
    text = (ROOT / "docs" / "architecture.md").read_text()
    for event in EVENTS:
        assert f"`{event}`" in text


@pytest.mark.parametrize("kind", KINDS)
def test_every_plugin_is_mentioned(kind):
    text = "".join(page.read_text() for page in PAGES)
    for name in registry.available(kind):
        assert f"`{name}`" in text or f"{kind}={name}" in text, f"no page mentions {kind}={name}"
