"""Planning and grasping: a fitted superquadric, grasps of both hands, a scripted episode."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from studio import Image, Studio, halved, room, save_png, ycb
from tensordict import TensorDictBase

import icub_core as icub
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.data import RgbdFrame
from icub_core.geometry import invert, look_at
from icub_core.scene import CameraView, Table
from icub_pipelines.images import captioned, contact_sheet

RECORDED = 12
"""Control steps between two images of the strip of a grasp."""
GREEN, ORANGE = (60, 220, 90), (255, 140, 30)


def projected(points: NDArray[np.float64], T_world_camera: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray:
    """Return pixel positions (N, 2) of world points (N, 3)."""
    T = invert(T_world_camera)
    local = points @ T[:3, :3].T + T[:3, 3]
    return local[:, :2] / local[:, 2:] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]


def wireframe(canvas: Image, shape: object, frame: RgbdFrame, color: tuple[int, int, int]) -> None:
    """Draw the near side of a superquadric's parameter lines on an image."""
    u, v = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 13), np.linspace(-np.pi, np.pi, 25), indexing="ij")
    unit = np.stack([np.cos(u) * np.cos(v), np.cos(u) * np.sin(v), np.sin(u)], axis=-1)
    R, half = shape.T_world_object[:3, :3], shape.half_axes  # type: ignore[attr-defined]
    rays = (unit * half) @ R.T + shape.center  # type: ignore[attr-defined]
    surface = shape.center + (rays - shape.center) / shape.gauge(rays)[..., None]  # type: ignore[attr-defined]
    facing = np.einsum("ijk,ijk->ij", shape.normals(surface), frame.T_world_camera[:3, 3] - surface) > 0  # type: ignore[attr-defined]
    pixels = projected(surface.reshape(-1, 3), frame.T_world_camera, frame.intrinsics).reshape(*surface.shape[:2], 2)
    for first, second in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        for a, b, shown in zip(
            pixels[first].reshape(-1, 2),
            pixels[second].reshape(-1, 2),
            (facing[first] & facing[second]).ravel(),
            strict=True,
        ):
            if shown:
                cv2.line(canvas, tuple(map(int, a.round())), tuple(map(int, b.round())), color, 1, cv2.LINE_AA)


def superquadric() -> None:
    """From a camera's cloud to a hand pose: mask, fitted superquadric, chosen pose, seen from elsewhere."""
    from icub_grasp_generators.superquadrics.fit import fit_superquadric
    from icub_tasks.grasping.plan import GraspPlan, plan_grasp

    (item,) = ycb("006_mustard_bottle")
    studio = Studio.open([item])
    studio.put(item, -0.34, 0.02, 0.5)
    simulator, description = studio.simulator, studio.robot.description
    place = simulator.object_pose(item.name)[:3, 3]
    seen = simulator.render("head_cam", 640, 480, look_at=place, segmentation=True, shadows=True)
    assert seen.segmentation is not None
    mask = seen.segmentation == 0
    cloud = seen.frame.to_cloud(mask)
    shape = fit_superquadric(cloud.points, Table().top).shape
    generator = icub.load("grasp_generator", "superquadrics")
    hand = description.hand("right")
    plan = plan_grasp(
        seen.frame,
        mask,
        item.name,
        generator,
        studio.robot,
        description.home_q,
        table=simulator.scene.table,
        hand=hand,
    )
    if not isinstance(plan, GraspPlan):
        raise SystemExit(f"no plan for the image: {plan.value}")
    first, second = seen.frame.rgb.copy(), seen.frame.rgb.copy()
    first[mask] = (0.45 * first[mask] + 0.55 * np.array(GREEN)).astype(np.uint8)
    wireframe(second, shape, seen.frame, ORANGE)
    panels = [
        captioned(crop(first, mask), "masked depth = cloud"),
        captioned(crop(second, mask), "fitted superquadric"),
    ]
    eye, center = np.array([-0.78, 0.40, 1.28]), np.array([-0.29, 0.03, 1.08])
    for title, T in (("pre-grasp, 10 cm before", plan.T_far), ("chosen hand pose", plan.grasp.T_world_hand)):
        solution = studio.robot.inverse_kinematics(T, plan.q_far, hand.frame, group=hand.reach)
        simulator.set_joint_positions(solution.q)
        view = simulator.render(CameraView(look_at(eye, center), 0.5), 640, 480, shadows=True).frame
        canvas = view.rgb.copy()
        wireframe(canvas, shape, view, ORANGE)
        panels.append(captioned(halved(canvas), title))
    save_png("superquadric", contact_sheet(panels, 2))


def crop(image: Image, mask: NDArray[np.bool_], width: int = 400) -> Image:
    """Cut out the surroundings of a mask, as 320 x 240."""
    rows, columns = np.nonzero(mask)
    height = width * 3 // 4
    top = int(np.clip(rows.mean() - height / 2, 0, image.shape[0] - height))
    left = int(np.clip(columns.mean() - width / 2, 0, image.shape[1] - width))
    return np.asarray(cv2.resize(image[top : top + height, left : left + width], (320, 240)), np.uint8)


def grasps() -> None:
    """The best grasp of each hand for three objects, as planned from the head camera's image."""
    items = ycb("004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle")
    studio = Studio.open(items, hands=["right", "left"])
    simulator, description = studio.simulator, studio.robot.description
    generator = icub.load("grasp_generator", "superquadrics")
    rows = []
    for side, sign in (("right", 1.0), ("left", -1.0)):
        row = []
        for item in items:
            simulator.reset()
            studio.put(item, -0.34, 0.03 * sign, 0.3 * sign)
            place = simulator.object_pose(item.name)[:3, 3]
            seen = simulator.render("head_cam", 640, 480, look_at=place, segmentation=True)
            assert seen.segmentation is not None
            cloud = seen.frame.to_cloud(seen.segmentation == items.index(item))
            answer = generator.propose(cloud, studio.robot, simulator.scene.table, side)
            if not answer:
                raise SystemExit(f"no grasp of '{item.name}' for the image: {answer.reason}")
            hand = description.hand(side)
            q = description.home_q
            for before in (0.10, 0.05, 0.0):
                T = answer.grasps[0].backed_off(before) if before else answer.grasps[0].T_world_hand
                q = studio.robot.inverse_kinematics(T, q, hand.frame, group=hand.reach).q
            simulator.set_joint_positions(q)
            shot = studio.shot((-0.95, 0.30 * sign, 1.40), (-0.28, 0.0, 1.10), 0.62)
            row.append(captioned(shot, f"{side} hand"))
        rows += row
    save_png("grasps", contact_sheet(rows, 3))


def grasp() -> None:
    """A scripted grasp in six images."""
    from icub_tasks.grasping.world import CONTROL_STEP

    name = "006_mustard_bottle"
    plugins = Assembly(compose())
    task = plugins.fresh("task", targets=[name], scene=room)
    studio = Studio(task.simulator(0), plugins.get("robot"))
    policy = icub.load("policy", "demonstrations")
    images: list[Image] = []

    steps = 0

    def record(world: int, task: icub.Task, episode: int, step: TensorDictBase) -> None:
        nonlocal steps
        if steps % RECORDED == 0:
            shot = studio.shot((-0.83, 0.42, 1.30), (-0.29, 0.03, 1.12), 0.55)
            images.append(captioned(shot, f"{steps * CONTROL_STEP:.1f} s"))
        steps += 1

    for seed in range(5):
        images.clear()
        steps = 0
        if icub.evaluate(policy, task, 1, seed, recorder=record).success[0]:
            break
    chosen = [images[int(i)] for i in np.linspace(0, len(images) - 1, 6)]
    save_png("grasp", contact_sheet(chosen, 3))
    task.close()
