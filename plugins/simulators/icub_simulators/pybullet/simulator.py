"""Simulator plugin: Bullet."""

from __future__ import annotations

from collections.abc import Sequence

from icub_core.errors import SimulationError
from icub_core.interfaces.simulator import Rendering
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene
from icub_simulators.engine import EngineSimulator
from icub_simulators.pybullet.camera import Camera
from icub_simulators.pybullet.client import check_installed
from icub_simulators.pybullet.world import World


class PyBullet(EngineSimulator[World]):
    """A world in Bullet, on the same contract as MuJoCo's: an independent test of grasps that needs no OpenGL.

    What differs: servos are velocity motors of the same stiffness and strength (see `servos`); frictions multiply,
    and are set so that the products are the same; saving clears the solver's memory of contacts, so that a run with a
    save in it differs in the last digits from one without; an image shows one light, and a backdrop of one color.

    Args:
        depth_noise: Give the depth of a stereo camera (noise, steps, holes at edges) instead of the true one.
    """

    def __init__(self, depth_noise: bool = False) -> None:
        check_installed()
        super().__init__(depth_noise)
        self._camera: Camera | None = None

    def set_appearance(
        self,
        *,
        table: Material | None = None,
        floor: Material | None = None,
        backdrop: Material | None = None,
        lights: Sequence[Light] | None = None,
    ) -> None:
        """Change materials and lights of the loaded world."""
        world, camera = self._world, self._open_camera()
        if table is not None:
            if world.table is None:
                raise SimulationError("this world has no table to change the look of")
            camera.set_surface(world.table, table)
        if floor is not None:
            camera.set_surface(world.floor, floor)
        camera.backdrop = backdrop if backdrop is not None else camera.backdrop
        camera.lights = tuple(lights) if lights is not None else camera.lights

    def _build(self, robot: RobotDescription | None, scene: Scene) -> World:
        return World(robot, scene)

    def _draw(self, view: CameraView, width: int, height: int, segmentation: bool, shadows: bool) -> Rendering:
        return self._open_camera().render(view, width, height, segmentation, shadows)

    def _open_camera(self) -> Camera:
        if self._camera is None:
            self._camera = Camera(self._world)
        return self._camera

    def _free(self) -> None:
        if self._engine is not None:
            self._engine.close()
        self._camera = None
