"""Every Python block of README and docs is executed, top to bottom, one namespace per page, as it stands."""

import sys
import types

import pytest
import torch
from tests.docs.pages import PAGES, blocks, pages

SLOW = {"README.md", "grasping.md", "perception.md"}
"""Pages whose blocks simulate or learn for more than a few seconds."""
MAX_NOT_EXECUTED = 5


def cases() -> list:
    return [
        pytest.param(page, id=page.name, marks=pytest.mark.slow if page.name in SLOW else [])
        for page in PAGES
        if blocks(page, "python")
    ]


@pytest.mark.timeout(900)  # the README learns for a minute beside its evaluations
@pytest.mark.parametrize("page", cases())
def test_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    threads = torch.get_num_threads()
    module = types.ModuleType(f"page_{page.stem}")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # dataclasses and pickles look their module up
    try:
        for block in blocks(page, "python"):
            if block.reason is None:
                code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
                exec(code, module.__dict__)
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("page", pages())
def test_blocks_are_python(page):
    """Holds for those that are not executed, too."""
    for block in blocks(page, "python"):
        compile(block.text, page.name, "exec")


def test_few_blocks_are_not_executed_and_each_says_why():
    reasons = [block.reason for page in PAGES for block in blocks(page, "python") if block.reason is not None]
    assert len(reasons) <= MAX_NOT_EXECUTED
    assert all(reason.strip() for reason in reasons)
