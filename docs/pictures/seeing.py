"""Seeing: data, and images of whole runs."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import imageio.v3 as iio
import numpy as np
from studio import Image, save_gif, save_png

import icub_core as icub
from icub_pipelines.images import captioned, color_of, contact_sheet, draw_instances


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
            cv2.drawContours(canvas, outlines, -1, color_of(str(number)), 2)
        samples.append(canvas)
    save_png("feature_task", contact_sheet(samples, 3))


def datasets() -> None:
    """Frames of the two rendered TARGET-TASKs with their annotations."""
    shown = []
    for name, indices in (("rendered_tabletop", (0, 12, 24)), ("rendered_handheld", (0, 16, 40))):
        frames = icub.load("dataset", name, split="train", frames=60)
        for i in indices:
            frame, instances = frames[i]
            shown.append(captioned(draw_instances(frame.rgb, instances), f"{name}[{i}]"))
    save_png("rendered_datasets", contact_sheet(shown, 3))


def main_job(run_folder: Path | None = None) -> None:
    """Taught masks, found objects, and the video that opens the README; from a run's folder, or a small run's."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = run_folder or Path(temporary)
        if run_folder is None:
            job = "run +segmenter=falkon +policy=demonstrations pipeline.see.frames=16 pipeline.grasp.worlds=4"
            more = f"pipeline.grasp.episodes=4 pipeline.grasp.video_episodes=4 run_dir={folder}"
            subprocess.run([sys.executable, "-m", "icub_core.cli", *job.split(), *more.split()], check=True)
        taught, seen = iio.imread(folder / "taught.png"), iio.imread(folder / "seen.png")
        video = iio.imread(folder / "grasp.gif")
    save_png("taught", contact_sheet(split(taught, 240, 320)[:4], 4))
    save_png("found", contact_sheet(split(seen, 240, 320)[:4], 2))
    shown = [("1  taught by showing, masks from depth", tile) for tile in split(taught, 240, 320)]
    shown += [("2  found on tables it never saw, among distractors", tile) for tile in split(seen, 240, 320)]
    stills = [titled(tile, title) for title, tile in shown]
    # the second half of the video, at twice its speed
    title = "3  planned and grasped (twice real time)"
    frames = [titled(image[..., :3], title) for image in video[len(video) // 2 :: 2]]
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


def split(sheet: Image, height: int, width: int) -> list[Image]:
    """Cut a contact sheet into its images, leaving out empty ones."""
    tiles = [
        sheet[y : y + height, x : x + width, :3]
        for y in range(0, sheet.shape[0], height)
        for x in range(0, sheet.shape[1], width)
    ]
    return [tile for tile in tiles if tile.any()]


def titled(image: Image, title: str) -> Image:
    """Put a line of text above an image, 480 x 384 in all."""
    canvas = np.full((384, 480, 3), 24, np.uint8)
    canvas[24:] = cv2.resize(image, (480, 360), interpolation=cv2.INTER_CUBIC)
    cv2.putText(canvas, title, (8, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235, 235, 235), 1, cv2.LINE_AA)
    return canvas
