"""Where a camera stands: free, on a link, or on a link and turned to a point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

from icub_core.errors import ConfigError, unknown_name
from icub_core.geometry import FloatArray, look_at, make_transform, quat_wxyz_to_matrix
from icub_core.robot_description import RobotCamera
from icub_core.scene import CameraView


def place_camera(
    camera: str | CameraView,
    named: Mapping[str, RobotCamera],
    link_pose: Callable[[str], FloatArray],
    target: FloatArray | None,
) -> CameraView:
    """Resolve a camera to a place in the world.

    Args:
        camera: A free camera, or the name of one of the robot's.
        named: The robot's cameras by name.
        link_pose: Gives T_world_link (4, 4).
        target: (3,) world point that the camera is turned to where it stands, or None.

    Raises:
        ConfigError: For an unknown name, with the nearest one.
    """
    if isinstance(camera, CameraView):
        T, fovy = camera.T_world_camera, camera.fovy
    else:
        if camera not in named:
            raise ConfigError(unknown_name("camera", camera, named))
        mounted = named[camera]
        T, fovy = link_pose(mounted.link) @ _on_link(mounted), mounted.fovy
    if target is not None:
        T = look_at(T[:3, 3], target)
    return CameraView(T, fovy)


@cache
def _on_link(camera: RobotCamera) -> FloatArray:
    """Return T_link_camera (4, 4)."""
    return make_transform(quat_wxyz_to_matrix(camera.quat_wxyz), camera.position)
