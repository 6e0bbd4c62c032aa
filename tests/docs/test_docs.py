"""What README and docs name exists: files, plugins, benchmarks, trainings, figures, events, images of a small size."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from tests.docs.pages import EXAMPLE, PAGES, ROOT, blocks, figures, of, pages, read, section

from icub_benchmarks.command import benchmarks
from icub_core import registry
from icub_core.config.compose import compose
from icub_core.hooks import EVENTS
from icub_core.kinds import KINDS
from icub_support.commands.train import trainer, trainings

REPRODUCE = ROOT / "docs" / "reproduce.md"
RUNNING = ROOT / "docs" / "running.md"


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", read(page), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", pages())
def test_relative_links_and_images_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", read(page)):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(there), f"{page.name} links to {target}; headings: {sorted(anchors(there))}"


@pytest.mark.parametrize("page", pages())
def test_paths_that_are_named_exist(page):
    named = re.findall(r"`((?:core|plugins|configs|docs|tests|examples|benchmarks|script)/[\w./-]+)`", read(page))
    for path in named:
        assert (ROOT / path).exists(), f"{page.name} names {path}"


@pytest.mark.parametrize("page", pages())
def test_modules_that_are_named_exist(page):
    """`icub_core.x.y` is a module, or a name in one."""
    for name in set(re.findall(r"`(icub_\w+(?:\.\w+)+)`", read(page))):
        if page.name == "CHANGELOG.md":  # tells of names that are gone
            continue
        found = re.sub(r"\.\w+$", "", name) if not _is_module(name) else name
        assert _is_module(found), f"{page.name} names {name}"
        if found != name:
            attribute = name.rpartition(".")[2]
            assert re.search(rf"\b{attribute}\b", _module(found).read_text(encoding="utf-8")), f"{page.name}: {name}"


def _module(name: str) -> Path:
    folders = [folder for folder in (*ROOT.glob("*/icub_*"), *ROOT.glob("plugins/*/icub_*")) if folder.is_dir()]
    package, *rest = name.split(".")
    base = next((folder for folder in folders if folder.name == package), ROOT / package).joinpath(*rest)
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def _is_module(name: str) -> bool:
    return _module(name).is_file()


def test_images_are_small():
    images = list((ROOT / "docs" / "images").iterdir())
    assert images
    for image in images:
        limit = 1_500_000 if image.suffix == ".gif" else 150_000
        assert image.stat().st_size <= limit, f"{image.name} is {image.stat().st_size} bytes; at most {limit}"


def test_every_image_is_shown():
    text = "".join(read(page) for page in PAGES)
    for image in (ROOT / "docs" / "images").iterdir():
        assert f"images/{image.name}" in text, f"no page shows {image.name}"


@pytest.mark.parametrize("words", [*of("icub run"), *of("script/run")])
def test_runs_compose(words):
    """The composition refuses unknown groups, plugins, keys and types."""
    start = 1 if words[0] == "script/run" else 2
    values = {"--cfg", "--resume", "--config-dir"}
    overrides = [
        word
        for before, word in zip(("", *words[start:]), words[start:], strict=False)
        if not word.startswith("-") and before not in values and "..." not in word
    ]
    if any(f"={name}" in word for word in overrides for name in EXAMPLE):
        pytest.skip("needs the example to be installed")
    sweep = any(word in ("-m", "--multirun") for word in words)
    compose([re.sub(r",[^\]]*$", "", word) if sweep else word for word in overrides])


@pytest.mark.parametrize("words", of("icub plugins"))
def test_plugin_commands_name_what_exists(words):
    assert words[2] in ("list", "show", "check")
    action, *rest = words[2:]
    rest = [word for word in rest if not word.startswith("--") and "=" not in word]
    if EXAMPLE & set(rest) or rest == ["KIND", "NAME"]:
        return
    if action == "show":
        assert any(rest[-1] in registry.available(kind) for kind in KINDS)
    elif rest:
        assert set(rest[1:]) <= set(registry.available(rest[0]))


@pytest.mark.parametrize("words", [case for case in of("icub train") if case.values[0][2] != "KIND=NAME"])
def test_trainings_exist(words):
    kind, _, name = words[2].partition("=")
    assert callable(trainer(kind, name))


def test_reproduce_lists_exactly_the_trainings():
    listed = re.findall(r"^\| `icub train ([\w=]+)`", section(REPRODUCE, "trainings"), re.M)
    assert sorted(listed) == sorted(name.replace(".", "=", 1) for name in trainings())


@pytest.mark.parametrize("page", pages())
def test_benchmarks_exist(page):
    for name in re.findall(r"icub benchmark (\w+)", read(page)):
        assert name in (*benchmarks(), "NAME"), f"{page.name} names the benchmark '{name}'"


def test_reproduce_lists_exactly_the_benchmarks():
    listed = re.findall(r"^\| `icub benchmark (\w+)`", section(REPRODUCE, "benchmarks"), re.M)
    assert sorted(listed) == sorted(benchmarks())


@pytest.mark.parametrize("page", pages())
def test_figures_that_are_named_exist(page):
    """A quoted key stands in benchmarks/results."""
    areas = {key.partition(".")[0] for key in figures()} - set(KINDS)
    for key in re.findall(r"`(\w+\.[a-z0-9_]+)`", read(page)):
        if key.partition(".")[0] in areas and not key.endswith((".json", ".log", ".gif", ".md", ".png")):
            assert key in figures(), f"{page.name} quotes {key}, which no result holds"


def test_events_are_all_listed():
    text = read(RUNNING)
    for event in EVENTS:
        assert f"`{event}`" in text


@pytest.mark.parametrize("kind", KINDS)
def test_every_plugin_is_mentioned(kind):
    text = "".join(read(page) for page in PAGES)
    for name in registry.available(kind):
        assert f"`{name}`" in text or f"{kind}={name}" in text, f"no page mentions {kind}={name}"


@pytest.mark.parametrize("page", pages())
def test_toml_and_json_blocks_parse(page):
    for block in blocks(page, "toml"):
        tomllib.loads(block.text)
    for block in blocks(page, "json"):
        json.loads(block.text)
