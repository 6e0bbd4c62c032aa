"""Two additions to Hydra's search path, registered in this process only.

A `hydra_plugins` namespace package would change the search path of every Hydra application in the environment, and
``pkg://`` sources would import third parties' packages; neither is used.
"""

from __future__ import annotations

from typing import Any, cast

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf

from icub_core.config.folders import TYPED_GROUPS, config_folders
from icub_core.config.overrides import NONE
from icub_core.config.schema import typed_node
from icub_core.config.settings import typed_group_node
from icub_core.kinds import KINDS
from icub_core.registry import available, load
from icub_core.renames import new_name, renamed_parameters

PROVIDER = "icub"
GROUPS = frozenset(KINDS) | {group for group, _ in TYPED_GROUPS}
"""Groups whose nodes are typed."""


class PluginConfigSource(ConfigSource):
    """Serves ``GROUP/NAME`` as a typed node, below what a YAML file of that name says.

    A plugin's node is made from its constructor, that of a core group from its dataclass. So one entry-point line is a
    whole plugin, a YAML file states only what differs from the defaults, and both refuse unknown keys and wrong types
    while Hydra composes. Only the plugin that is chosen is imported.
    """

    @staticmethod
    def scheme() -> str:
        """Scheme of the search path element ``icub://``."""
        return "icub"

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the typed node of ``GROUP/NAME``, with the YAML file merged in when there is one."""
        group, name = _split(config_path)
        if group in KINDS and name == NONE:
            return ConfigResult(PROVIDER, "icub://", OmegaConf.create({group: None}), header={"package": "_global_"})
        result = _from_file(config_path)
        if result is None:
            return ConfigResult(PROVIDER, "icub://", _typed(group, name), header={"package": None})
        result.config = _on_typed_node(group, name, result)
        return result

    def available(self) -> bool:
        """Say that this source exists."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Return True if the path is a group with typed nodes."""
        return config_path.strip("/") in ("", *GROUPS)

    def is_config(self, config_path: str) -> bool:
        """Return True if the path is an option of such a group, with or without a YAML file."""
        group, name = _split(config_path)
        return name in self.list(group, ObjectType.CONFIG) or (
            group in GROUPS and (_from_file(config_path) is not None or (group in KINDS and name == NONE))
        )

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """List the groups, or the options of one group."""
        path = config_path.strip("/")
        if not path:
            return [] if results_filter is ObjectType.CONFIG else sorted(GROUPS)
        if path not in GROUPS or results_filter is ObjectType.GROUP:
            return []
        return sorted(available(path) if path in KINDS else (option for group, option in TYPED_GROUPS if group == path))


def _split(config_path: str) -> tuple[str, str]:
    group, _, name = config_path.removesuffix(".yaml").partition("/")
    return group, name


def _from_file(config_path: str) -> ConfigResult | None:
    if config_path.count("/") != 1:
        return None
    for folder in config_folders():
        source = FileConfigSource(PROVIDER, f"file://{folder}")
        if source.is_config(config_path):
            return source.load_config(config_path)
    return None


def _typed(group: str, name: str) -> DictConfig:
    if group in KINDS:
        return typed_node(group, name, load(group, name), follow_run=True)
    node = typed_group_node(group, name)
    return node if node is not None else cast(DictConfig, OmegaConf.create({}))


def _on_typed_node(group: str, name: str, result: ConfigResult) -> Any:
    """Merge a YAML file's values onto the node of the plugin it names; one that names none inherits by its defaults."""
    content = result.config
    if not isinstance(content, DictConfig):
        return content
    is_global = result.header.get("package") == "_global_"
    if group in KINDS:
        values = content.get(group) if is_global else content
        chosen = values.get("plugin") if isinstance(values, DictConfig) else None
    else:
        chosen = name if (group, name) in TYPED_GROUPS else None
    if not isinstance(chosen, str):
        return content
    if group in KINDS:
        values = content[group] if is_global else content
        for old in [str(key) for key in values if new_name(load(group, chosen), str(key))]:
            values.update(renamed_parameters(load(group, chosen), {old: values.pop(old)}))
    node = OmegaConf.create({group: _typed(group, chosen)})
    defaults = content.pop("defaults", None)
    merged = OmegaConf.merge(node, content if is_global else {group: content})
    assert isinstance(merged, DictConfig)
    config = merged if is_global else merged[group]
    if defaults is None:
        return config
    if is_global:
        config["defaults"] = defaults
        return config
    # a typed node cannot hold the extra key `defaults`; the values are checked again when the run is composed
    return OmegaConf.create({"defaults": defaults, **cast(dict[str, Any], OmegaConf.to_container(config))})


class IcubSearchPath(SearchPathPlugin):
    """Puts the plugins' own source before, and every configuration folder after, what Hydra searches anyway."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Add the elements."""
        search_path.prepend(PROVIDER, "icub://")
        for folder in config_folders():
            search_path.append(PROVIDER, f"file://{folder}")


def register() -> None:
    """Make Hydra know both, in this process; calling it again changes nothing."""
    Plugins.instance().register(PluginConfigSource)
    Plugins.instance().register(IcubSearchPath)
