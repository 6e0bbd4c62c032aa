"""Where configuration files lie: one folder for every `icub.configs` entry point, found without importing anything."""

from __future__ import annotations

import functools
import logging
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from icub_core.errors import ConfigError
from icub_core.kinds import KINDS
from icub_core.registry import available

ENTRY_POINT_GROUP = "icub.configs"
OWN = "icub"
"""Name of this project's own entry point; its folder holds the primary ``config.yaml``."""

TYPED_GROUPS = {("scene", "tabletop"): "icub_core.config.settings:SceneSettings"}
"""Group and option to the dataclass whose fields are its keys."""

logger = logging.getLogger(__name__)


@functools.cache
def config_folders() -> tuple[Path, ...]:
    """Return the folders, this project's own first; a third party's folder that is missing is reported and left out."""
    found: dict[str, Path] = {}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        folder = _locate(entry.value)
        if folder is None or not folder.is_dir():
            owner = entry.dist.name if entry.dist else entry.name
            logger.warning("the configuration folder '%s' of %s does not exist (package data?)", entry.value, owner)
            continue
        found[entry.name] = folder
    if OWN not in found:
        raise ConfigError("the package icub_configs is not installed; type: pip install -e .")
    return (found.pop(OWN), *dict.fromkeys(found.values()))


def _locate(package: str) -> Path | None:
    """Find a package's folder from its top-level name alone: `find_spec` of a subpackage would import its parent."""
    top, *rest = package.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(next(iter(spec.submodule_search_locations)), *rest)


def groups(folders: tuple[Path, ...] | None = None) -> dict[str, tuple[str, ...]]:
    """Return every top-level configuration group and its options; a kind's options include plugins without a file."""
    options: dict[str, set[str]] = {kind: set(available(kind)) for kind in KINDS}
    for group, option in TYPED_GROUPS:
        options.setdefault(group, set()).add(option)
    for folder in folders or config_folders():
        for directory in folder.iterdir():
            if directory.is_dir() and not directory.name.startswith(("_", ".")):
                options.setdefault(directory.name, set()).update(file.stem for file in directory.glob("*.yaml"))
    return {group: tuple(sorted(names)) for group, names in sorted(options.items())}
