"""README and docs, taken apart: blocks, commands, inline code."""

import functools
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
EXAMPLE = {"top_down", "hold"}
"""Plugins of examples/third_party_plugin (a test of the framework installs and runs it) and of writing_plugins.md."""
_BLOCK = re.compile(
    r"(?:^<!-- not executed: (?P<reason>[^\n]*?) -->\n)?^```(?P<language>\w*)\n(?P<body>.*?)^```", re.M | re.S
)


@dataclass(frozen=True)
class Block:
    """A fenced block; `line` is the page's line on which its text begins, `reason` why it is not executed."""

    language: str
    text: str
    line: int
    reason: str | None


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def pages(among: list[Path] = PAGES) -> list:
    return [pytest.param(page, id=page.name) for page in among]


def blocks(page: Path, language: str) -> list[Block]:
    text = read(page)
    return [
        Block(match["language"], match["body"], text.count("\n", 0, match.start("body")) + 1, match["reason"])
        for match in _BLOCK.finditer(text)
        if match["language"] == language
    ]


def commands() -> Iterator[tuple[Path, tuple[str, ...]]]:
    """Yield every line of a shell block, and every inline code that is a command, without comments."""
    for page in PAGES:
        lines = [line for block in blocks(page, "") for line in block.text.replace("\\\n", " ").splitlines()]
        lines += [code for code in inline_code(page) if code.startswith("icub ")]
        for line in lines:
            words = tuple(shlex.split(line, comments=True))
            if words:
                yield page, words


def of(tool: str) -> list:
    """Return the commands that begin with `tool`, each once, as pytest parameters."""
    first = tool.split()
    fitting = ((page, words) for page, words in commands() if list(words[: len(first)]) == first)
    found = {words: page for page, words in fitting if len(words) > len(first)}
    return [pytest.param(words, id=f"{page.name}: {' '.join(words)}") for words, page in found.items()]


def inline_code(page: Path) -> list[str]:
    """Return the inline code of a page."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", _BLOCK.sub("", read(page)))]


def section(page: Path, name: str) -> str:
    """Return what stands between the marks ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``."""
    match = re.search(rf"<!-- {name}:begin -->\n(.*?)<!-- {name}:end -->", read(page), re.S)
    assert match, f"{page.name} lacks the marks <!-- {name}:begin --> and <!-- {name}:end -->"
    return match[1]


@functools.cache
def figures() -> frozenset[str]:
    """Return the keys of all figures in benchmarks/results."""
    files = (ROOT / "benchmarks" / "results").glob("*.json")
    return frozenset(key for file in files for key in json.loads(file.read_text(encoding="utf-8"))["figures"])
