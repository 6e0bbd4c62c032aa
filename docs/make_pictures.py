"""Makes the pictures of the documentation with the project's own simulator and library calls.

    python docs/make_pictures.py                         # all of them, several minutes
    python docs/make_pictures.py robot hands             # some
    python docs/make_pictures.py main_job --run runs/X   # from the folder of a run that was done before

They lie in docs/images: PNGs of at most 150 kB, one GIF of at most 1.5 MB.
"""

from __future__ import annotations

import argparse
import io
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from tensordict import TensorDictBase

from icub_core import registry
from icub_core.data import RgbdFrame
from icub_core.geometry import invert, look_at, make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.gl import choose_backend
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.pipeline.pictures import captioned, colour_of, contact_sheet, draw_instances
from icub_core.scene import CameraView, Light, Material, ObjectSpec, Scene, Table

Image = NDArray[np.uint8]
FOLDER = Path(__file__).parent / "images"
MOST_PNG, MOST_GIF = 150_000, 1_500_000
KEY = Light(direction=(0.45, -0.5, -1.0), diffuse=(0.42, 0.42, 0.42), ambient=(0.26, 0.26, 0.26))
FILL = Light(direction=(0.7, 0.8, -0.6), diffuse=(0.22, 0.22, 0.22), ambient=(0.26, 0.26, 0.26))
STUDIO = (KEY, FILL)
WALL = Material(rgba=(0.80, 0.83, 0.87, 1.0))
FLOOR = Material(rgba=(0.55, 0.58, 0.62, 1.0))
WOOD = Material(rgba=(0.60, 0.47, 0.35, 1.0))
FILMED = 12
"""Control steps between two pictures of the strip of a grasp."""
GREEN, ORANGE = (60, 220, 90), (255, 140, 30)

logger = logging.getLogger("make_pictures")


def save_png(name: str, image: Image) -> None:
    """Write a PNG of 256 colours, smaller until it fits into the limit."""
    path, picture = FOLDER / f"{name}.png", Pillow.fromarray(image)
    while True:
        buffer = io.BytesIO()
        # a palette refined by a few rounds of k-means: the median cut alone turns skin and wood grey
        picture.quantize(256, kmeans=4, dither=Pillow.Dither.NONE).save(buffer, "png", optimize=True)
        if buffer.tell() <= MOST_PNG:
            path.write_bytes(buffer.getvalue())
            logger.info("%s: %d x %d, %d kB", path, *picture.size, buffer.tell() // 1000)
            return
        picture = picture.resize((int(0.9 * picture.width), int(0.9 * picture.height)), Pillow.Resampling.LANCZOS)


def save_gif(name: str, stills: Sequence[Image], film: Sequence[Image], seconds: Sequence[float]) -> None:
    """Write an endless GIF of still pictures and a film, smaller until it fits into the limit."""
    path, width = FOLDER / f"{name}.gif", film[0].shape[1]
    while True:
        size = (width, round(width * film[0].shape[0] / film[0].shape[1]))
        small = [Pillow.fromarray(f).resize(size, Pillow.Resampling.LANCZOS) for f in (*stills, *film)]
        # one palette for the film: what does not move stays the same and compresses to nothing
        middle = small[len(stills) + len(film) // 2].quantize(128, kmeans=4)
        drawn = [f.quantize(128, kmeans=2, dither=Pillow.Dither.NONE) for f in small[: len(stills)]]
        drawn += [f.quantize(palette=middle, dither=Pillow.Dither.NONE) for f in small[len(stills) :]]
        buffer = io.BytesIO()
        durations = [int(1000 * s) for s in seconds]
        drawn[0].save(buffer, "gif", save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=False)
        if buffer.tell() <= MOST_GIF:
            path.write_bytes(buffer.getvalue())
            logger.info("%s: %d x %d, %d frames, %d kB", path, *size, len(drawn), buffer.tell() // 1000)
            return
        width = int(0.92 * width)


@dataclass
class Studio:
    """A loaded simulator with its robot, and a friendly light."""

    simulator: Simulator
    robot: Robot

    @classmethod
    def open(cls, objects: Sequence[ObjectSpec] = (), table: bool = True, **robot: object) -> Studio:
        """Load the robot, the table and `objects`."""
        body = registry.build("robot", {"plugin": "icub", **robot})
        simulator = registry.build("simulator", "mujoco")
        furniture = Table(material=WOOD) if table else None
        simulator.load(body.description, Scene(tuple(objects), furniture, lights=STUDIO, floor=FLOOR, backdrop=WALL))
        simulator.reset()
        return cls(simulator, body)

    def shot(
        self,
        eye: Sequence[float],
        target: Sequence[float],
        fovy: float,
        size: tuple[int, int] = (320, 240),
        shadows: bool = True,
    ) -> Image:
        """Photograph from a free place, twice as large and halved again: smooth edges."""
        view = CameraView(look_at(eye, target), fovy)
        large = self.simulator.render(view, 2 * size[0], 2 * size[1], shadows=shadows).frame.rgb
        return np.asarray(cv2.resize(large, size, interpolation=cv2.INTER_AREA), np.uint8)

    def put(self, item: ObjectSpec, x: float, y: float, yaw: float = 0.0) -> None:
        """Stand an object on the table."""
        R = rotation_about("z", yaw) @ quat_wxyz_to_matrix(item.rest_quat_wxyz)
        self.simulator.set_object_pose(item.name, make_transform(R, [x, y, Table().top + item.rest_height]))


def ycb(*names: str) -> list[ObjectSpec]:
    """Return objects of the set ycb_primitives; all of them when none is named."""
    objects = registry.build("objects", "ycb_primitives")
    return [objects.get(name) for name in names or objects.names]


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


def depth_picture(depth: NDArray[np.float32]) -> Image:
    """Colour metres from near (yellow) to far (violet); nothing measured is black."""
    seen = depth > 0
    low, high = np.percentile(depth[seen], [1, 95])
    grey = np.clip(255 * (1 - (depth - low) / (high - low)), 0, 255).astype(np.uint8)
    coloured = cv2.cvtColor(cv2.applyColorMap(grey, cv2.COLORMAP_PLASMA), cv2.COLOR_BGR2RGB)
    coloured[~seen] = 0
    return np.asarray(coloured, np.uint8)


def cameras() -> None:
    """What each camera sees, in colour, depth and segmentation."""
    items = ycb("004_sugar_box", "006_mustard_bottle", "005_tomato_soup_can", "010_potted_meat_can")
    studio = Studio.open(items)
    for item, (x, y) in zip(items, [(-0.33, 0.02), (-0.45, -0.12), (-0.42, 0.14), (-0.28, 0.13)], strict=True):
        studio.put(item, x, y, 0.6)
    simulator = studio.simulator
    target = np.array([-0.36, 0.03, Table().top + 0.03])
    straight = simulator.render("head_cam", 320, 240, shadows=True)
    turned = simulator.render("head_cam", 320, 240, look_at=target, segmentation=True, shadows=True)
    front = simulator.render("front_cam", 320, 240, shadows=True)
    colours = np.array([(30, 30, 34), (230, 200, 60), (220, 60, 60), (70, 160, 230), (90, 200, 110)], np.uint8)
    assert turned.segmentation is not None
    sheet = [
        captioned(straight.frame.rgb, "head_cam, as the neck holds it"),
        captioned(turned.frame.rgb, "head_cam, look_at=object"),
        captioned(front.frame.rgb, "front_cam"),
        captioned(depth_picture(straight.frame.depth), "its depth"),
        captioned(depth_picture(turned.frame.depth), "its depth"),
        captioned(colours[turned.segmentation + 1], "the second one's segmentation"),
    ]
    save_png("cameras", contact_sheet(sheet, 3))


def objects() -> None:
    """The eight YCB primitives, and random objects resized for the hand."""
    random = registry.build("objects", {"plugin": "random1000", "graspable": True})
    lamp = Light(direction=(-0.5, -0.5, -1.0), diffuse=(0.6, 0.6, 0.6), ambient=(0.42, 0.42, 0.42))
    for name, items in (
        ("objects_ycb_primitives", ycb()),
        ("objects_random1000", [random.get(n) for n in random.names[:96:12]]),
    ):
        simulator = registry.build("simulator", "mujoco")
        simulator.load(None, Scene(tuple(items), Table(material=WOOD), lights=(lamp,), floor=FLOOR, backdrop=WALL))
        simulator.reset()
        studio = Studio(simulator, None)  # type: ignore[arg-type]  # no robot is looked at here
        for i, item in enumerate(items):
            studio.put(item, -0.42 - 0.2 * (i % 2), -0.42 + 0.12 * i, 0.6)
        save_png(name, studio.shot((0.60, 0.0, 1.62), (-0.50, 0.0, 1.03), 0.40, (640, 280)))


def projected(points: NDArray[np.float64], T_world_camera: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray:
    """Return pixel positions (N, 2) of world points (N, 3)."""
    T = invert(T_world_camera)
    local = points @ T[:3, :3].T + T[:3, 3]
    return local[:, :2] / local[:, 2:] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]


def wireframe(canvas: Image, shape: object, frame: RgbdFrame, colour: tuple[int, int, int]) -> None:
    """Draw the near side of a superquadric's parameter lines on a picture."""
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
                cv2.line(canvas, tuple(map(int, a.round())), tuple(map(int, b.round())), colour, 1, cv2.LINE_AA)


def superquadric() -> None:
    """From a camera's cloud to a hand pose: mask, fitted superquadric, chosen pose, seen from elsewhere."""
    from icub_core.grasping.plan import GraspPlan, plan_grasp
    from icub_grasp_generators.superquadrics.fit import fit_superquadric

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
    generator = registry.build("grasp_generator", "superquadrics")
    plan = plan_grasp(
        seen.frame, mask, item.name, generator, studio.robot, description.home_q, table=simulator.scene.table
    )
    if not isinstance(plan, GraspPlan):
        raise SystemExit(f"no plan for the picture: {plan.value}")
    first, second = seen.frame.rgb.copy(), seen.frame.rgb.copy()
    first[mask] = (0.45 * first[mask] + 0.55 * np.array(GREEN)).astype(np.uint8)
    wireframe(second, shape, seen.frame, ORANGE)
    panels = [
        captioned(crop(first, mask), "masked depth = cloud"),
        captioned(crop(second, mask), "fitted superquadric"),
    ]
    frame = description.hand_frames["right"]
    eye, centre = np.array([-0.78, 0.40, 1.28]), np.array([-0.29, 0.03, 1.08])
    for title, T in (("pre-grasp, 10 cm before", plan.T_far), ("chosen hand pose", plan.grasp.T_world_hand)):
        solution = studio.robot.inverse_kinematics(T, plan.q_far, frame, group="right_reach")
        simulator.set_joint_positions(solution.q)
        picture = simulator.render(CameraView(look_at(eye, centre), 0.5), 640, 480, shadows=True).frame
        canvas = picture.rgb.copy()
        wireframe(canvas, shape, picture, ORANGE)
        panels.append(captioned(halved(canvas), title))
    save_png("superquadric", contact_sheet(panels, 2))


def halved(image: Image) -> Image:
    """Return an image of 320 x 240."""
    return np.asarray(cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA), np.uint8)


def crop(image: Image, mask: NDArray[np.bool_], width: int = 400) -> Image:
    """Cut out the surroundings of a mask, as 320 x 240."""
    rows, columns = np.nonzero(mask)
    height = width * 3 // 4
    top = int(np.clip(rows.mean() - height / 2, 0, image.shape[0] - height))
    left = int(np.clip(columns.mean() - width / 2, 0, image.shape[1] - width))
    return np.asarray(cv2.resize(image[top : top + height, left : left + width], (320, 240)), np.uint8)


def grasp() -> None:
    """A scripted grasp in six pictures."""
    from icub_core.grasping.env import GraspEnv
    from icub_core.grasping.evaluation import evaluate
    from icub_core.grasping.task import CONTROL_STEP, GraspTask

    (item,) = ycb("006_mustard_bottle")
    studio = Studio.open([item])
    generator, policy = registry.build("grasp_generator", "superquadrics"), registry.build("policy", "demonstrations")
    env = GraspEnv([GraspTask(studio.simulator, studio.robot, generator, [item.name])])
    pictures: list[Image] = []

    steps = 0

    def record(world: int, env: GraspEnv, episode: int, step: TensorDictBase) -> None:
        nonlocal steps
        if steps % FILMED == 0:
            shot = studio.shot((-0.83, 0.42, 1.30), (-0.29, 0.03, 1.12), 0.55)
            pictures.append(captioned(shot, f"{steps * CONTROL_STEP:.1f} s"))
        steps += 1

    for seed in range(5):
        pictures.clear()
        steps = 0
        if evaluate(policy, env, 1, seed, recorder=record).success[0]:
            break
    chosen = [pictures[int(i)] for i in np.linspace(0, len(pictures) - 1, 6)]
    save_png("grasp", contact_sheet(chosen, 3))
    env.close()


def feature_task() -> None:
    """Samples of the FEATURE-TASK with their exact masks."""
    from icub_datasets.feature_task.renderer import FeatureTaskRenderer

    renderer = FeatureTaskRenderer()
    samples = []
    for seed in (0, 2, 4, 5, 9, 12):
        sample = renderer.render(seed)
        canvas = sample.rgb.copy()
        for number in range(1, len(sample.labels) + 1):
            mask = (sample.instances == number).astype(np.uint8)
            outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(canvas, outlines, -1, colour_of(str(number)), 2)
        samples.append(canvas)
    save_png("feature_task", contact_sheet(samples, 3))


def datasets() -> None:
    """Frames of the two rendered TARGET-TASKs with their annotations."""
    shown = []
    for name, indices in (("rendered_tabletop", (0, 12, 24)), ("rendered_handheld", (0, 16, 40))):
        frames = registry.build("dataset", {"plugin": name, "split": "train", "frames": 60})
        for i in indices:
            frame, instances = frames[i]
            shown.append(captioned(draw_instances(frame.rgb, instances), f"{name}[{i}]"))
    save_png("rendered_datasets", contact_sheet(shown, 3))


def main_job(run_folder: Path | None = None) -> None:
    """Taught masks, found objects, and the film that opens the README; from a run's folder, or a small run's."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = run_folder or Path(temporary)
        if run_folder is None:
            job = "run +segmenter=falkon +policy=demonstrations pipeline.see.frames=16 pipeline.grasp.worlds=4"
            more = f"pipeline.grasp.episodes=4 pipeline.grasp.video_episodes=4 run_dir={folder}"
            subprocess.run([sys.executable, "-m", "icub_core.cli", *job.split(), *more.split()], check=True)
        taught, seen = iio.imread(folder / "taught.png"), iio.imread(folder / "seen.png")
        film = iio.imread(folder / "grasp.gif")
    save_png("taught", contact_sheet(split(taught, 240, 320)[:4], 4))
    save_png("found", contact_sheet(split(seen, 240, 320)[:4], 2))
    shown = [("1  taught by showing, masks from depth", tile) for tile in split(taught, 240, 320)]
    shown += [("2  found on tables it never saw, among strangers", tile) for tile in split(seen, 240, 320)]
    stills = [titled(tile, title) for title, tile in shown]
    # the second half of the film, at twice its speed
    frames = [
        titled(picture[..., :3], "3  planned and grasped (twice real time)") for picture in film[len(film) // 2 :: 2]
    ]
    seconds = [0.9] * len(stills) + [0.1] * (len(frames) - 1) + [1.5]
    save_gif("main_job", stills, frames, seconds)


def corrected(run_folder: Path | None = None) -> None:
    """A false positive before and after its object was taught; from the run folder of teach_by_showing."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = run_folder or Path(temporary)
        if run_folder is None:
            job = f"run +segmenter=falkon pipeline=teach_by_showing run_dir={folder}"
            subprocess.run([sys.executable, "-m", "icub_core.cli", *job.split()], check=True)
        tiles = [t for part in ("before", "after") for t in split(iio.imread(folder / f"{part}.png"), 240, 320)[:3]]
    save_png("corrected", contact_sheet(tiles, 3))


FROM_RUNS = {"main_job": main_job, "corrected": corrected}


def split(sheet: Image, height: int, width: int) -> list[Image]:
    """Cut a contact sheet into its pictures, leaving out empty ones."""
    tiles = [
        sheet[y : y + height, x : x + width, :3]
        for y in range(0, sheet.shape[0], height)
        for x in range(0, sheet.shape[1], width)
    ]
    return [tile for tile in tiles if tile.any()]


def titled(picture: Image, title: str) -> Image:
    """Put a line of text above a picture, 480 x 384 in all."""
    canvas = np.full((384, 480, 3), 24, np.uint8)
    canvas[24:] = cv2.resize(picture, (480, 360), interpolation=cv2.INTER_CUBIC)
    cv2.putText(canvas, title, (8, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return canvas


PICTURES: dict[str, Callable[[], None]] = {
    made.__name__: made
    for made in (robot, hands, cameras, objects, superquadric, grasp, feature_task, datasets, main_job, corrected)
}


def main() -> None:
    """Make the pictures named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="NAME", nargs="*", help=", ".join(PICTURES))
    parser.add_argument("--run", type=Path, help="for main_job or corrected: folder of such a run")
    options = parser.parse_args()
    for name in options.names:
        if name not in PICTURES:
            parser.error(f"no picture named '{name}'; known: {', '.join(PICTURES)}")
    names = options.names or list(PICTURES)
    if len(names) > 1:  # a process each: the FEATURE-TASK's renderer and the simulator's need OpenGL in different ways
        if options.run:
            parser.error("--run needs the name of the one picture that is made from the run")
        for name in names:
            subprocess.run([sys.executable, __file__, name], check=True)
        return
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    FOLDER.mkdir(exist_ok=True)
    if names[0] in FROM_RUNS:
        FROM_RUNS[names[0]](options.run)
        return
    # the renderer of the FEATURE-TASK is MuJoCo's own, which looks at the environment when it is imported
    os.environ.setdefault("MUJOCO_GL", choose_backend())
    PICTURES[names[0]]()


if __name__ == "__main__":
    main()
