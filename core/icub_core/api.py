"""The calls that make plugins, environments and figures in one line each (`import icub_core as icub`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.interfaces.task import Task
from icub_core.rollouts import EpisodeResults, evaluate

__all__ = ["EpisodeResults", "evaluate", "load", "make_env"]


def load(kind: str, name: str, *, overrides: Sequence[str] = (), **parameters: Any) -> Any:
    """Build a plugin with everything that it is composed of.

    ``load("segmenter", "falkon")`` brings the feature extractor and the heads that its configuration names.

    Args:
        kind: Name of the kind, such as ``"segmenter"``.
        name: Registry name.
        overrides: Further words as after ``icub run``, such as ``"online_head.sigma=20"``.
        **parameters: Of the plugin's constructor.

    Raises:
        ConfigError: No such plugin or parameter, or a value that does not fit.
        PluginError: A plugin that cannot be imported.
    """
    return Assembly(compose([f"{kind}={name}", *overrides], read=[kind])).fresh(kind, **parameters)


def make_env(
    task: str | None = None,
    *,
    objects: Sequence[str] | None = None,
    num_envs: int = 1,
    overrides: Sequence[str] = (),
    **parameters: Any,
) -> Task:
    """Build a task: a TorchRL environment of `num_envs` worlds.

    Args:
        task: Registry name; None takes the one that runs take by default.
        objects: Names of the objects that episodes are about; None takes all of the object set.
        num_envs: Worlds.
        overrides: Further words as after ``icub run``, such as ``"robot=tiny"`` or ``"simulator=pybullet"``.
        **parameters: Of the task's constructor.

    Raises:
        ConfigError: No such task or parameter, or a value that does not fit.
        PluginError: A plugin that cannot be imported.
    """
    chosen = {} if objects is None else {"targets": list(objects)}
    words = [] if task is None else [f"task={task}"]
    made: Task = Assembly(compose([*words, *overrides])).fresh("task", num_envs=num_envs, **chosen, **parameters)
    return made
