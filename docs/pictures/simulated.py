"""The simulated robot and its world: robot, hands, cameras, objects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from studio import FLOOR, WALL, WOOD, Image, Studio, save_png, ycb

import icub_core as icub
from icub_core.scene import Light, Scene, Table
from icub_pipelines.images import captioned, contact_sheet


def robot() -> None:
    """The whole robot at its table."""
    items = ycb("004_sugar_box", "006_mustard_bottle", "010_potted_meat_can")
    studio = Studio.open(items, hands=["right", "left"])
    for item, (x, y, yaw) in zip(items, [(-0.36, 0.02, 0.4), (-0.48, -0.22, 0.3), (-0.52, 0.25, 0.9)], strict=True):
        studio.put(item, x, y, yaw)
    front = studio.shot((-1.75, 0.75, 1.65), (-0.15, 0.03, 1.15), 0.5, (400, 400))
    side = studio.shot((-1.15, -1.05, 1.40), (-0.20, 0.0, 1.14), 0.62, (400, 400))
    save_png("robot", np.concatenate([front, side], axis=1))


def hands() -> None:
    """Both hands, open and closed by their own tendons."""
    studio = Studio.open(table=False, hands=["right", "left"])
    simulator, description = studio.simulator, studio.robot.description
    A, b = description.actuator_matrix()
    rows = []
    for state in ("open", "close"):
        simulator.reset()
        targets = A @ description.home_q + b
        for side in ("right", "left"):
            for name in description.hand_actuators[side]:
                (i,) = description.actuator_indices((name,))
                targets[i] = getattr(description.actuators[i], state)
        simulator.set_targets(targets)
        simulator.step(400)
        row = []
        for side, sign in (("right", 1.0), ("left", -1.0)):
            T = simulator.link_pose(description.hand_frames[side])
            middle = T[:3, 3] + 0.02 * T[:3, 0] + sign * 0.02 * T[:3, 2]
            eye = middle + sign * 0.26 * T[:3, 2] + 0.10 * T[:3, 0] - 0.16 * T[:3, 1]
            x, y, z = (middle - eye + [0.0, 0.15, -0.1]).tolist()
            lamp = Light((x, y, z), (0.5, 0.5, 0.5), (0.42, 0.42, 0.42))
            simulator.set_appearance(lights=(lamp,))
            row.append(captioned(studio.shot(eye, middle, 0.62, shadows=False), f"{side} hand, {state}"))
        rows.append(np.concatenate(row, axis=1))
    save_png("hands", np.concatenate(rows))


def depth_image(depth: NDArray[np.float32]) -> Image:
    """Color meters from near (yellow) to far (violet); nothing measured is black."""
    seen = depth > 0
    low, high = np.percentile(depth[seen], [1, 95])
    gray = np.clip(255 * (1 - (depth - low) / (high - low)), 0, 255).astype(np.uint8)
    colored = cv2.cvtColor(cv2.applyColorMap(gray, cv2.COLORMAP_PLASMA), cv2.COLOR_BGR2RGB)
    colored[~seen] = 0
    return np.asarray(colored, np.uint8)


def cameras() -> None:
    """What each camera sees, in color, depth and segmentation."""
    items = ycb("004_sugar_box", "006_mustard_bottle", "005_tomato_soup_can", "010_potted_meat_can")
    studio = Studio.open(items)
    for item, (x, y) in zip(items, [(-0.33, 0.02), (-0.45, -0.12), (-0.42, 0.14), (-0.28, 0.13)], strict=True):
        studio.put(item, x, y, 0.6)
    simulator = studio.simulator
    target = np.array([-0.36, 0.03, Table().top + 0.03])
    straight = simulator.render("head_cam", 320, 240, shadows=True)
    turned = simulator.render("head_cam", 320, 240, look_at=target, segmentation=True, shadows=True)
    front = simulator.render("front_cam", 320, 240, shadows=True)
    colors = np.array([(30, 30, 34), (230, 200, 60), (220, 60, 60), (70, 160, 230), (90, 200, 110)], np.uint8)
    assert turned.segmentation is not None
    sheet = [
        captioned(straight.frame.rgb, "head_cam, as the neck holds it"),
        captioned(turned.frame.rgb, "head_cam, look_at=object"),
        captioned(front.frame.rgb, "front_cam"),
        captioned(depth_image(straight.frame.depth), "its depth"),
        captioned(depth_image(turned.frame.depth), "its depth"),
        captioned(colors[turned.segmentation + 1], "the second one's segmentation"),
    ]
    save_png("cameras", contact_sheet(sheet, 3))


def objects() -> None:
    """The eight YCB primitives, household things, and random objects resized for the hand."""
    random = icub.load("objects", "random1000", graspable=True)
    household = icub.load("objects", "household")
    lamp = Light(direction=(-0.5, -0.5, -1.0), diffuse=(0.6, 0.6, 0.6), ambient=(0.42, 0.42, 0.42))
    for name, items in (
        ("objects_ycb_primitives", ycb()),
        ("objects_household", [household.get(n) for n in household.names[5::18]]),
        ("objects_random1000", [random.get(n) for n in random.names[:96:12]]),
    ):
        simulator = icub.load("simulator", "mujoco")
        simulator.load(None, Scene(tuple(items), Table(material=WOOD), lights=(lamp,), floor=FLOOR, backdrop=WALL))
        simulator.reset()
        studio = Studio(simulator, None)  # type: ignore[arg-type]  # no robot is looked at here
        for i, item in enumerate(items):
            studio.put(item, -0.42 - 0.2 * (i % 2), -0.42 + 0.12 * i, 0.6)
        save_png(name, studio.shot((0.60, 0.0, 1.62), (-0.50, 0.0, 1.03), 0.40, (640, 280)))
