"""Simulator plugin: MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray
from icub_core.interfaces.simulator import Rendering
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene
from icub_simulators.engine import EngineSimulator
from icub_simulators.mujoco.physics import Physics
from icub_simulators.mujoco.renderer import Renderer


class Mujoco(EngineSimulator[Physics]):
    """A world in MuJoCo.

    Solver: Newton, elliptic friction cones, friction 20 times stiffer than the normal direction. With the engine's
    defaults (pyramidal cones, ratio 1) fingers creep round what they hold and nearly every grasp fails.

    Args:
        depth_noise: Give the depth of a stereo camera (noise, steps, holes at edges) instead of the true one.
    """

    def __init__(self, depth_noise: bool = False) -> None:
        super().__init__(depth_noise)
        self._renderer: Renderer | None = None

    @property
    def model(self) -> mujoco.MjModel:
        """The engine's model, for experiments; changing it changes the world."""
        return self._world.model

    @property
    def data(self) -> mujoco.MjData:
        """The engine's data, for experiments."""
        return self._world.data

    def hand_and_object(
        self, frame: str, hand: str, name: str
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
        """T_world_frame (4, 4), actuator lengths (m,), fingertip contacts (t,), object position (3,)."""
        return (self._engine or self._world).hand_and_object(frame, hand, name)

    def set_appearance(
        self,
        *,
        table: Material | None = None,
        floor: Material | None = None,
        backdrop: Material | None = None,
        lights: Sequence[Light] | None = None,
    ) -> None:
        """Change materials and lights of the loaded world."""
        if table is not None and self._world.scene.table is None:
            raise SimulationError("this world has no table to change the look of")
        self._open_renderer().set_appearance(table, floor, backdrop, lights)

    def _build(self, robot: RobotDescription | None, scene: Scene) -> Physics:
        return Physics(robot, scene)

    def _draw(self, view: CameraView, width: int, height: int, segmentation: bool, shadows: bool) -> Rendering:
        world = self._world
        return self._open_renderer().render(
            world.data.qpos, world.parked, view, width, height, segmentation, shadows, world.time
        )

    def _open_renderer(self) -> Renderer:
        """Return the renderer, made when first used: physics alone needs no graphics library."""
        if self._renderer is None:
            world = self._world
            self._renderer = Renderer(world.robot, world.scene)
        return self._renderer

    def _free(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None
