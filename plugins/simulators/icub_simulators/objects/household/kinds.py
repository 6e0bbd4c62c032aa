"""Kinds of household things, each a recipe with random proportions.

No training set holds their shapes: the FEATURE-TASK's products are boxes, cylinders, ellipsoids and stacks of them, and
the shapes of VGN's hand trials are cartons, cans, straight bottles and tools made of boxes. Sizes are meters; things
stand on z = 0 or, tools, lie about there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from icub_simulators.objects.household.parts import (
    Part,
    bent,
    block,
    hollow,
    hull,
    joined,
    prism,
    revolved,
    rod,
)

Rng = np.random.Generator


def _bottle(rng: Rng) -> Part:
    """Build a round bottle with a waist, curved shoulders and a cap."""
    radius, body, height = rng.uniform(0.028, 0.042), rng.uniform(0.09, 0.14), rng.uniform(0.18, 0.24)
    waist, neck = radius * rng.uniform(0.75, 0.95), radius * rng.uniform(0.3, 0.42)
    shoulder = body + 0.6 * (height - body)
    curve = [(neck + (radius - neck) * np.cos(t), body + (shoulder - body) * np.sin(t)) for t in (0.5, 1.0, 1.4)]
    cap = neck * rng.uniform(1.15, 1.5)
    profile = [(0.85 * radius, 0.0), (radius, 0.012), (waist, 0.5 * body), (radius, body), *curve]
    return revolved([*profile, (neck, height - 0.018), (cap, height - 0.018), (0.95 * cap, height)])


def _mug(rng: Rng) -> Part:
    """Build an open cup with an ear."""
    radius, height = rng.uniform(0.034, 0.046), rng.uniform(0.075, 0.115)
    foot = radius * rng.uniform(0.75, 1.0)
    cup = hollow([(foot, 0.0), (radius, 0.35 * height), (radius * rng.uniform(0.95, 1.08), height)], 0.005)
    return joined([cup, _ear(0.97 * radius, 0.2 * height, 0.8 * height, rng.uniform(0.024, 0.034), 0.0055)])


def _bowl(rng: Rng) -> Part:
    """Build a round bowl on a ring."""
    radius, height = rng.uniform(0.06, 0.09), rng.uniform(0.04, 0.07)
    foot, bulge = radius * rng.uniform(0.4, 0.55), rng.uniform(0.75, 0.9)
    return hollow([(foot, 0.0), (bulge * radius, 0.45 * height), (radius, height)], 0.006)


def _jar(rng: Rng) -> Part:
    """Build a jar with six or eight flat sides, a round neck and a wide lid."""
    radius, height = rng.uniform(0.035, 0.05), rng.uniform(0.07, 0.12)
    neck, lid = radius * rng.uniform(0.6, 0.72), radius * rng.uniform(0.74, 0.9)
    glass = revolved(
        [(0.93 * radius, 0.0), (radius, 0.01), (radius, 0.72 * height), (neck, 0.84 * height), (neck, 0.9 * height)],
        sides=int(rng.choice([6, 8])),
    )
    return joined([glass, revolved([(lid, 0.86 * height), (lid, 0.97 * height), (0.9 * lid, height)])])


def _carton(rng: Rng) -> Part:
    """Build a milk carton with a gable and a fin."""
    x, y, body = rng.uniform(0.055, 0.075), rng.uniform(0.06, 0.085), rng.uniform(0.1, 0.16)
    gable, fin = rng.uniform(0.025, 0.04), rng.uniform(0.012, 0.02)
    eaves = [(sx * x / 2, sy * y / 2, body) for sx in (-1, 1) for sy in (-1, 1)]
    ridge = [(sx * 0.004, sy * y / 2, body + gable) for sx in (-1, 1) for sy in (-1, 1)]
    roof = hull(np.array([*eaves, *ridge]))
    return joined([block(x, y, body), roof, block(0.008, y, fin).moved(z=body + gable)])


def _spray(rng: Rng) -> Part:
    """Build an oval spray bottle with a head and a trigger."""
    radius, body = rng.uniform(0.036, 0.046), rng.uniform(0.12, 0.16)
    bottle = revolved(
        [(0.92 * radius, 0.0), (radius, 0.01), (radius * rng.uniform(0.8, 1.0), 0.6 * body), (0.4 * radius, body)]
    ).stretched(y=rng.uniform(0.6, 0.8))
    neck = rod((0.0, 0.0, body), (0.0, 0.0, body + 0.03), 0.3 * radius)
    length = rng.uniform(0.06, 0.085)
    head = block(length, 0.024, 0.028).moved(x=0.2 * length, z=body + 0.025)
    front = 0.7 * length
    nozzle = rod((front, 0.0, body + 0.042), (front + 0.014, 0.0, body + 0.042), 0.008, 0.006)
    trigger = rod((0.42 * length, 0.0, body + 0.027), (0.55 * length, 0.0, body - 0.02), 0.006, 0.004)
    return joined([bottle, neck, head, nozzle, trigger])


def _jug(rng: Rng) -> Part:
    """Build an open jug, narrower at the neck, with an ear and a lip."""
    radius, height = rng.uniform(0.045, 0.06), rng.uniform(0.13, 0.18)
    neck = radius * rng.uniform(0.6, 0.8)
    edge = neck * rng.uniform(1.0, 1.25)
    body = hollow([(0.8 * radius, 0.0), (radius, 0.35 * height), (neck, 0.8 * height), (edge, height)], 0.006)
    lip = hull(
        np.array(
            [(-0.9 * edge, s * 0.4 * edge, z) for s in (-1, 1) for z in (0.88 * height, height)]
            + [(-1.45 * edge, 0.0, height), (-edge, 0.0, height)]
        )
    )
    return joined([body, lip, _ear(0.9 * neck, 0.3 * height, 0.92 * height, 1.15 * radius, 0.007)])


def _pan(rng: Rng) -> Part:
    """Build a low pan with a straight handle."""
    radius, height, length = rng.uniform(0.055, 0.075), rng.uniform(0.028, 0.045), rng.uniform(0.09, 0.13)
    dish = hollow([(radius * rng.uniform(0.8, 0.95), 0.0), (radius, height)], 0.005)
    end = (radius + length, 0.0, height + rng.uniform(0.0, 0.02))
    return joined([dish, rod((radius - 0.006, 0.0, 0.75 * height), end, 0.007, 0.01)])


def _goblet(rng: Rng) -> Part:
    """Build a foot, a stem and a cup."""
    foot, stem, cup = rng.uniform(0.034, 0.042), rng.uniform(0.05, 0.08), rng.uniform(0.03, 0.042)
    height = rng.uniform(0.06, 0.09)
    base = revolved([(foot, 0.0), (foot, 0.004), (0.2 * foot, 0.014), (0.15 * foot, stem)])
    edge = cup * rng.uniform(0.8, 1.0)
    bowl = hollow([(0.35 * cup, 0.0), (cup, 0.5 * height), (edge, height)], 0.005)
    return joined([base, bowl.moved(z=stem - 0.002)])


def _teapot(rng: Rng) -> Part:
    """Build a round pot with a spout, an ear and a knob."""
    radius, height = rng.uniform(0.05, 0.06), rng.uniform(0.08, 0.1)
    belly = [(radius * np.cos(t), 0.5 * height * (1 + np.sin(t) / np.sin(1.1))) for t in np.linspace(-1.1, 1.1, 7)]
    knob = [(0.1 * radius, height), (0.16 * radius, height + 0.008), (0.08 * radius, height + 0.016)]
    tip = (-1.65 * radius, 0.0, rng.uniform(0.8, 1.0) * height)
    spout = rod((-0.8 * radius, 0.0, 0.4 * height), tip, 0.016, 0.008)
    return joined(
        [revolved(belly), revolved(knob), spout, _ear(0.8 * radius, 0.25 * height, 0.8 * height, 0.045, 0.006)]
    )


def _hammer(rng: Rng) -> Part:
    """Build a hammer with a round face and a wedge behind."""
    length, head = rng.uniform(0.16, 0.22), rng.uniform(0.07, 0.1)
    thick = rng.uniform(0.011, 0.015)
    handle = rod((0.0, 0.0, 0.0), (length, 0.0, 0.0), rng.uniform(0.009, 0.013), 0.011)
    face = rod((0.0, 0.0, 0.0), (0.0, 0.5 * head, 0.0), 0.8 * thick, 1.15 * thick)
    wedge = [(x, -0.5 * head, z) for x in (-thick, thick) for z in (-0.002, 0.002)]
    back = [(x, 0.0, z) for x in (-thick, thick) for z in (-0.8 * thick, 0.8 * thick)]
    return joined([handle, face, hull(np.array([*wedge, *back]))])


def _wrench(rng: Rng) -> Part:
    """Build a flat wrench with an open jaw at each end."""
    length, width, thick = rng.uniform(0.12, 0.18), rng.uniform(0.014, 0.02), rng.uniform(0.007, 0.01)
    parts = [block(length, width, thick)]
    for side in (-1.0, 1.0):
        gap = width * rng.uniform(0.35, 0.6)
        for s in (-1.0, 1.0):
            prong = [(0.0, s * 2.4), (side * 2.2, s * 2.2), (side * 2.6, s), (side * 0.7, s)]
            parts.append(prism(gap * np.array(prong), thick).moved(x=side * length / 2))
        parts.append(block(1.4 * gap, 4.4 * gap, thick).moved(x=side * length / 2))
    return joined(parts)


def _screwdriver(rng: Rng) -> Part:
    """Build an eight-sided handle with a waist, a shaft and a flat blade."""
    radius, grip, shaft = rng.uniform(0.012, 0.017), rng.uniform(0.08, 0.1), rng.uniform(0.06, 0.11)
    waist = [(radius, 0.75 * grip), (0.65 * radius, 0.88 * grip), (0.85 * radius, grip)]
    handle = revolved([(0.7 * radius, 0.0), (radius, 0.012), *waist], sides=8)
    end = grip + shaft
    blade = hull(
        np.array(
            [(sx * 0.004, sy * 0.004, end - 0.002) for sx in (-1, 1) for sy in (-1, 1)]
            + [(sx * 0.006, sy * 0.001, end + 0.014) for sx in (-1, 1) for sy in (-1, 1)]
        )
    )
    return joined([handle, rod((0.0, 0.0, grip), (0.0, 0.0, end), 0.004), blade])


def _brush(rng: Rng) -> Part:
    """Build a flat brush: a tapered handle, a ferrule, and bristles that spread."""
    width, handle, bristles = rng.uniform(0.04, 0.065), rng.uniform(0.1, 0.13), rng.uniform(0.035, 0.06)
    thick = rng.uniform(0.012, 0.018)
    near = [(0.0, s * 0.4 * width, z) for s in (-1, 1) for z in (0.0, thick)]
    far = [(handle, s * 0.13 * width, z) for s in (-1, 1) for z in (0.1 * thick, 0.8 * thick)]
    ferrule = block(0.022, width, 1.2 * thick).moved(x=-0.011)
    root = [(-0.022, s * 0.47 * width, z) for s in (-1, 1) for z in (0.1 * thick, thick)]
    ends = [(-0.022 - bristles, s * 0.6 * width, z) for s in (-1, 1) for z in (0.4 * thick, 0.7 * thick)]
    return joined([hull(np.array([*near, *far])), ferrule, hull(np.array([*root, *ends]))])


def _dumbbell(rng: Rng) -> Part:
    """Build a bar between two weights of six or eight sides."""
    radius, thick, bar = rng.uniform(0.026, 0.036), rng.uniform(0.028, 0.042), rng.uniform(0.08, 0.11)
    sides = int(rng.choice([6, 8]))
    edge = 0.006
    weight = [(radius - edge, 0.0), (radius, edge), (radius, thick - edge), (radius - edge, thick)]
    upper = revolved(weight, sides)
    bar_part = rod((0.0, 0.0, 0.5 * thick), (0.0, 0.0, bar + 1.5 * thick), 0.3 * radius)
    return joined([upper, upper.moved(z=bar + thick), bar_part])


def _stapler(rng: Rng) -> Part:
    """Build an open stapler: a base, an arm above it and a hinge behind."""
    length, width, gap = rng.uniform(0.1, 0.15), rng.uniform(0.026, 0.038), rng.uniform(0.02, 0.035)
    base = block(length, width, 0.012)
    back, front, side = -0.5 * length, 0.5 * length, 0.42 * width
    tail = [(back, s * side, z) for s in (-1, 1) for z in (0.02, 0.042)]
    nose = [(front, s * 0.8 * side, z + gap) for s in (-1, 1) for z in (0.012, 0.03)]
    hinge = block(0.22 * length, width, 0.034).moved(x=-0.39 * length)
    return joined([base, hull(np.array([*tail, *nose])), hinge])


def _car(rng: Rng) -> Part:
    """Build a toy car with a cabin and four wheels."""
    length, width, height = rng.uniform(0.11, 0.15), rng.uniform(0.05, 0.065), rng.uniform(0.025, 0.035)
    wheel = rng.uniform(0.015, 0.02)
    body = block(length, width, height).moved(z=0.7 * wheel)
    half, side = rng.uniform(0.25, 0.32) * length, 0.42 * width
    cabin = prism([(half, side), (-half, side), (-half, -side), (half, -side)], rng.uniform(0.025, 0.035), 0.65)
    parts = [body, cabin.moved(x=rng.uniform(-0.08, 0.08) * length, z=0.7 * wheel + height)]
    for x in (-0.31 * length, 0.31 * length):
        for s in (-1.0, 1.0):
            parts.append(rod((x, s * 0.36 * width, wheel), (x, s * 0.56 * width, wheel), wheel))
    return joined(parts)


def _tube(rng: Rng) -> Part:
    """Build a squeezed tube that is flat at one end, on its cap."""
    radius, length = rng.uniform(0.018, 0.025), rng.uniform(0.1, 0.14)
    cap, tall = radius * rng.uniform(0.8, 1.05), rng.uniform(0.018, 0.026)
    angles = 2 * np.pi * np.arange(24) / 24
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(24, tall)])
    crimp = [(sx * 1.4 * radius, sy * 0.0015, tall + length) for sx in (-1, 1) for sy in (-1, 1)]
    return joined([revolved([(0.9 * cap, 0.0), (cap, tall)]), hull(np.concatenate([ring, np.array(crimp)]))])


def _ear(radius: float, low: float, high: float, reach: float, thick: float) -> Part:
    """Build the handle of a vessel of this radius, from one height to another."""
    out, bend = radius + reach, 0.22 * (high - low)
    return bent(
        [
            (radius, 0.0, low),
            (radius + 0.75 * reach, 0.0, low + 0.3 * bend),
            (out, 0.0, low + bend),
            (out, 0.0, high - bend),
            (radius + 0.75 * reach, 0.0, high - 0.3 * bend),
            (radius, 0.0, high),
        ],
        thick,
    )


STANDING: dict[str, Callable[[Rng], Part]] = {
    "bottle": _bottle,
    "bowl": _bowl,
    "car": _car,
    "carton": _carton,
    "goblet": _goblet,
    "jar": _jar,
    "jug": _jug,
    "mug": _mug,
    "pan": _pan,
    "spray": _spray,
    "stapler": _stapler,
    "teapot": _teapot,
}
"""Kinds that stand as they are built."""
LYING: dict[str, Callable[[Rng], Part]] = {
    "brush": _brush,
    "dumbbell": _dumbbell,
    "hammer": _hammer,
    "screwdriver": _screwdriver,
    "tube": _tube,
    "wrench": _wrench,
}
"""Kinds that lie in their lowest stable pose."""
