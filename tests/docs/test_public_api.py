"""docs/public_api.md names exactly what is public."""

import importlib
import re
import tomllib

from tests.docs.pages import ROOT, read, section

import icub_core
from icub_core.kinds import KINDS

PAGE = ROOT / "docs" / "public_api.md"


def test_the_page_lists_exactly_what_is_public():
    listed = re.findall(r"`(\w+)`", "\n".join(row.split("|")[1] for row in section(PAGE, "api").splitlines()[2:]))
    assert sorted(listed) == sorted(icub_core.__all__)
    assert len(listed) == len(set(listed))


def test_every_public_name_can_be_imported():
    for name in icub_core.__all__:
        assert getattr(importlib.import_module("icub_core"), name) is not None


def test_the_page_lists_the_kinds_with_the_versions_of_their_interfaces():
    rows = re.findall(r"^\| `icub\.(\w+)` \| (\d+) \|", section(PAGE, "kinds"), re.M)
    assert {name: int(version) for name, version in rows} == {name: kind.version for name, kind in KINDS.items()}


def test_the_page_lists_every_other_entry_point_group():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    known = {group.removeprefix("icub.") for group in project["project"]["entry-points"]} - set(KINDS)
    listed = set(re.findall(r"^\| `icub\.([\w.]+)`", section(PAGE, "groups"), re.M))
    assert known == listed


def test_the_version_of_the_changelog_is_the_package_s():
    heading = re.search(r"^## (\d+\.\d+\.\d+)", read(ROOT / "CHANGELOG.md"), re.M)
    assert heading is not None
    assert heading[1] == icub_core.__version__
