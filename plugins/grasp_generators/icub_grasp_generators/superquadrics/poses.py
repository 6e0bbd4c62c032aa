"""Hand poses around a superquadric, and what each of them costs.

A hand squeezes along the x axis of its grip and its palm looks along z. Poses are therefore drawn from one family: x
horizontal at angle a, and a roll phi about x that takes the palm from looking down (0) to looking sideways (90
degrees),

    R(a, phi, theta) = [(cos a, sin a, 0), (sin a, -cos a, 0), (0, 0, -1)] Rx(phi) Ry(theta)   (columns of the first),

where theta dips the fingers, which reaches objects that are turned away from the arm. The palm is a small gap in front
of the solid, the solid's center on the line between thumb and fingers, and the hand may be shifted along y. Poses are
those of the planning frame (see `planned_hand`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from icub_core.geometry import FloatArray, rotation_about
from icub_core.scene import Table
from icub_grasp_generators.hand_geometry import Spheres
from icub_grasp_generators.planned_hand import PlannedHand
from icub_grasp_generators.reach import clears_table
from icub_grasp_generators.superquadrics.evidence import Evidence
from icub_grasp_generators.superquadrics.shape import Superquadric

PALM_GAP = 0.004
"""Meters between the palm's surface and the solid."""

_YAW_STEP = np.radians(15.0)
_YAWS = np.radians(np.arange(0.0, 360.0, 15.0))
_CLOSE = 1e-9
_YAW_OFFSETS = (0.0, 0.15, -0.15)
_ROLLS = np.radians([-45.0, -29.0, 0.0, 29.0, 46.0, 63.0, 77.0, 90.0])
_DIPS = np.radians([0.0, -15.0, -30.0])
_SHIFTS = np.array([-0.04, -0.02, 0.0, 0.02, 0.04])  # along y

_PENETRATION = 0.003  # of the open hand into the solid: contact moves a finger that much without harm
_SUNK = 0.001  # meters by which the hand's ellipsoid dips into the palm
_SPARE_WIDTH = 0.02  # meters of the hand's width that should stay free
_RAY, _RAY_POINTS = 0.078, 27  # half length, meters, of a finger's path on which the solid is looked for


@dataclass(frozen=True, eq=False)
class Candidates:
    """Hand poses with the terms of their costs.

    Attributes:
        T: (C, 4, 4) world poses of the planning frame.
        cost: (C,) sum of the terms; lower is better.
    """

    T: FloatArray
    cost: FloatArray


def family(shape: Superquadric, hand: PlannedHand) -> FloatArray:
    """Return every pose (C, 4, 4) of the hand's family around `shape`, before any test."""
    horizontal = shape.T_world_object[:2, :3]
    lengths = np.linalg.norm(horizontal, axis=0)
    own = np.arctan2(horizontal[1], horizontal[0])[lengths > 0.7]
    own = np.concatenate([own, own + np.pi])[:, None] + np.array(_YAW_OFFSETS)
    low, high = hand.yaws
    even = _YAWS[(_YAWS > low - _CLOSE) & (_YAWS < high + _CLOSE)]
    own = own.ravel() % (2 * np.pi)
    yaws = np.concatenate([own[(own >= low - _YAW_STEP) & (own <= high + _YAW_STEP)], even])
    c, s, zero = np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))
    flat = np.stack(
        [np.stack([c, s, zero], -1), np.stack([s, -c, zero], -1), np.stack([zero, zero, zero - 1.0], -1)], axis=-1
    )
    rolls = np.stack([rotation_about("x", phi) @ rotation_about("y", theta) for phi in _ROLLS for theta in _DIPS])
    R = (flat[:, None] @ rolls[None]).reshape(-1, 3, 3)
    palm = hand.palm
    reach, _ = shape.support(-R[:, :, 2])
    T = np.tile(np.eye(4), (len(R), len(_SHIFTS), 1, 1))
    T[..., :3, :3] = R[:, None]
    T[..., :3, 3] = (
        shape.center
        - palm[0] * R[:, None, :, 0]
        - (palm[1] + _SHIFTS[:, None]) * R[:, None, :, 1]
        - (reach + PALM_GAP + palm[2])[:, None, None] * R[:, None, :, 2]
    )
    return T.reshape(-1, 4, 4)


def evaluate(
    shape: Superquadric,
    T: FloatArray,
    hand: PlannedHand,
    body: Spheres,
    table: Table | None,
    evidence: Evidence | None = None,
) -> tuple[Candidates, str]:
    """Drop poses that are too wide, in the table or in the solid, and cost the others.

    Args:
        shape: The object.
        T: (C, 4, 4) world poses of the planning frame.
        hand: What closes around the object.
        body: The open hand, in the planning frame.
        table: What it must stay out of.
        evidence: What the camera saw; None where its place is not known.

    Returns:
        The surviving candidates, cheapest first, and, when there is none, what stood in the way of the last ones.
    """
    reach, _ = shape.support(T[:, :3, 0])
    width = 2 * reach
    keep = width <= hand.width
    if not keep.any():
        return _nothing(), f"the object is {1e3 * width.min():.0f} mm wide; the hand takes {1e3 * hand.width:.0f} mm"
    T, width = T[keep], width[keep]
    keep = clears_table(body.at(T), body.radii, table)
    if not keep.any():
        return _nothing(), "at every pose around the object the open hand meets the table"
    T, width = T[keep], width[keep]
    keep = np.all(shape.distance(body.at(T)) - body.radii > -_PENETRATION, axis=1)
    if not keep.any():
        return _nothing(), "at every pose around the object the open hand meets the object"
    T, width = T[keep], width[keep]
    easy = round(hand.width - _SPARE_WIDTH, 9)
    cost = (
        _ray_cost(shape, hand, T)
        + _ellipsoid_cost(shape, hand, T)
        + _lever_cost(shape, hand, T)
        + 20.0 * np.maximum(width - easy, 0.0)
    )
    if evidence is not None:
        cost += evidence.cost(T)
    order = np.argsort(cost, kind="stable")
    return Candidates(T[order], cost[order]), ""


def _nothing() -> Candidates:
    return Candidates(np.zeros((0, 4, 4)), np.zeros(0))


def _ray_cost(shape: Superquadric, hand: PlannedHand, T: FloatArray) -> FloatArray:
    """How little the closing fingers find: (C,), 0 when all meet faces square to their motion, 2 when none does."""
    count, middle = len(hand.fingers), hand.palm[0]
    local = np.zeros((count, _RAY_POINTS, 3))
    local[..., 0] = np.linspace(middle - _RAY, middle + _RAY, _RAY_POINTS)
    local[..., 1:] = hand.fingers[:, None]
    points = local.reshape(-1, 3) @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    inside = shape.gauge(points).reshape(len(T), count, _RAY_POINTS) < 1.0
    found = inside.sum(axis=2) >= 3
    # the last point inside is where a finger lands; its face should look along the finger's motion
    last = np.where(found, _RAY_POINTS - 1 - np.argmax(inside[..., ::-1], axis=2), 0)
    landing = np.take_along_axis(points.reshape(len(T), count, _RAY_POINTS, 3), last[..., None, None], axis=2)
    square = np.abs(np.einsum("cfk,ck->cf", shape.normals(landing[:, :, 0]), T[:, :3, 0]))
    return 2.0 * np.mean(np.where(found, 1.5 * (1.0 - square), 1.0), axis=1)


@functools.lru_cache(maxsize=8)
def _ellipsoid_points(hand: PlannedHand) -> FloatArray:
    """The thumb-and-palm half (x + z <= 0) of the hand's ellipsoid, in the planning frame: (M, 3)."""
    unit = Superquadric.from_parts(np.ones(3), np.ones(2), np.eye(3), np.zeros(3)).surface(78)
    center = np.array([*hand.palm[:2], round(float(hand.palm[2] + hand.half_axes[2] - _SUNK), 9)])
    return (unit * hand.half_axes)[unit[:, 0] + unit[:, 2] <= 0] + center


def _ellipsoid_cost(shape: Superquadric, hand: PlannedHand, T: FloatArray) -> FloatArray:
    """Mean (F^e1 - 1)^2 over the hand's ellipsoid: how well the hand wraps the solid (manipulation by Vezzani 2017)."""
    points = _ellipsoid_points(hand) @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    off = np.minimum(shape.gauge(points) ** 2 - 1.0, 3.0)
    return 0.1 * np.mean(off**2, axis=1)


def _lever_cost(shape: Superquadric, hand: PlannedHand, T: FloatArray) -> FloatArray:
    """Distance of the center from the line between thumb and fingers: a heavy object turns in the hand about it."""
    local = np.einsum("cji,cj->ci", T[:, :3, :3], shape.center - T[:, :3, 3])
    lever = np.hypot(local[:, 1] - hand.palm[1], local[:, 2] - hand.fingers[0, 1])
    return 10.0 * np.maximum(lever - 0.015, 0.0)
