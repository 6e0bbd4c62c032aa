"""The grasping task as a Gymnasium environment: ``gymnasium.make("icub/Grasp-v0", objects=[...])``."""

from __future__ import annotations

from typing import Any

from icub_support.gym_adapter import GymTask, gym_task


def make(render_mode: str | None = None, **options: Any) -> GymTask:
    """Build one world; `options` are those of `icub_core.make_env`."""
    return gym_task("grasp", render_mode, **options)
