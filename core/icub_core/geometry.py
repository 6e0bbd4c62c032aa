"""Rigid transforms in numpy. Quaternions are wxyz; angles are radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_IDENTITY = np.eye(3)
_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])


def is_rigid(T: NDArray[np.floating], tolerance: float = 1e-5) -> bool:
    """Return True if `T` is a (4, 4) rotation and translation: finite, R R^T = I, det R = +1."""
    if T.shape != (4, 4):
        return False
    R = T[:3, :3]
    # every rendered frame is checked: plain arithmetic takes a tenth of np.allclose's time, and a NaN fails it too
    orthogonal = np.abs(R @ R.T - _IDENTITY).max() <= tolerance
    return bool(
        orthogonal and np.abs(T[3] - _LAST_ROW).max() <= tolerance and np.linalg.det(R) > 0 and np.all(np.isfinite(T))
    )


def make_transform(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> FloatArray:
    """Build a (4, 4) transform from a (3, 3) rotation and a (3,) translation, either of which may be left out."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = np.asarray(rotation)
    if translation is not None:
        T[:3, 3] = np.asarray(translation)
    return T


def invert(T: FloatArray) -> FloatArray:
    """Invert rigid transforms of shape (..., 4, 4)."""
    inverse = np.zeros_like(T)
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = R_t
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", R_t, T[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def quat_wxyz_to_matrix(quat_wxyz: ArrayLike) -> FloatArray:
    """Convert quaternions (..., 4), normalized here, to rotations (..., 3, 3)."""
    q = np.asarray(quat_wxyz, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_to_quat_wxyz(R: ArrayLike) -> FloatArray:
    """Convert one rotation (3, 3) to a unit quaternion (4,) wxyz with w >= 0 (Shepperd's method)."""
    m = np.asarray(R, dtype=np.float64)
    trace = np.trace(m)
    diagonal = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    largest = int(np.argmax(diagonal))
    q = np.empty(4)
    q[largest] = 1 + 2 * diagonal[largest] - trace  # 4 q_i^2
    if largest == 0:
        q[1:] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = m[k, j] - m[j, k]
        q[1 + j] = m[j, i] + m[i, j]
        q[1 + k] = m[k, i] + m[i, k]
    q /= np.linalg.norm(q)
    return q if q[0] >= 0 else -q


def rpy_to_matrix(rpy: ArrayLike) -> FloatArray:
    """Return the rotation (3, 3) of the URDF's roll, pitch, yaw (3,): R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    return rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll)


def matrix_to_rpy(R: ArrayLike) -> FloatArray:
    """Return roll, pitch, yaw (3,) of a rotation (3, 3), such that `rpy_to_matrix` gives it back.

    At pitch +-pi/2, where only roll -+ yaw is defined, yaw is 0.
    """
    m = np.asarray(R, dtype=np.float64)
    cosine = float(np.hypot(m[0, 0], m[1, 0]))
    pitch = np.arctan2(-m[2, 0], cosine)
    if cosine < 1e-9:
        return np.array([np.arctan2(-m[1, 2], m[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(m[2, 1], m[2, 2]), pitch, np.arctan2(m[1, 0], m[0, 0])])


def rotation_about(axis: str, angle: float) -> FloatArray:
    """Return the (3, 3) rotation by `angle` about the named axis, ``"x"``, ``"y"`` or ``"z"``."""
    c, s = np.cos(angle), np.sin(angle)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def rotation_log(R: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) of R (3, 3), exact also near 0 and pi."""
    quat = matrix_to_quat_wxyz(R)
    sine = float(np.linalg.norm(quat[1:]))
    if sine < 1e-12:
        return 2.0 * quat[1:]
    return 2.0 * np.arctan2(sine, quat[0]) / sine * quat[1:]


def rotation_exp(vector: ArrayLike) -> FloatArray:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    v = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return quat_wxyz_to_matrix(np.concatenate([[1.0], v / 2]))
    return quat_wxyz_to_matrix(np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) / angle * v]))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of two vectors (3,): `np.cross` takes twenty times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
    """Return T_world_camera (camera z forward, y down) of a camera at `eye` whose axis meets `target`."""
    eye = np.asarray(eye, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - eye
    forward = forward / np.linalg.norm(forward)
    right = _cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-9:  # looking along `up`: any right-hand side will do
        right = _cross(forward, np.array([1.0, 0.0, 0.0]))
    right /= np.linalg.norm(right)
    return make_transform(np.array([right, _cross(forward, right), forward]).T, eye)


def pinhole(width: int, height: int, fovy: float) -> FloatArray:
    """Return the (3, 3) intrinsics of an ideal camera with vertical field of view `fovy` (rad).

    Whole pixel coordinates are pixel centers: the middle of 320 columns is 159.5.
    """
    focal = 0.5 * height / np.tan(0.5 * fovy)
    return np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
