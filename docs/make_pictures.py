"""Makes the images of the documentation with the project's own simulator and library calls.

    python docs/make_pictures.py                         # all of them, several minutes
    python docs/make_pictures.py robot hands             # some
    python docs/make_pictures.py main_job --run runs/X   # from the folder of a run that was done before

They lie in docs/images: PNGs of at most 150 kB, one GIF of at most 1.5 MB. docs/pictures holds how each is made.
"""

from __future__ import annotations

import argparse
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "pictures"))

from grasping import grasp, grasps, superquadric
from seeing import corrected, datasets, feature_task, main_job
from simulated import cameras, hands, objects, robot
from studio import FOLDER

from icub_support.gl import choose_backend

FROM_RUNS = {"main_job": main_job, "corrected": corrected}
PICTURES: dict[str, Callable[[], None]] = {
    made.__name__: made
    for made in (
        robot,
        hands,
        cameras,
        objects,
        superquadric,
        grasps,
        grasp,
        feature_task,
        datasets,
        main_job,
        corrected,
    )
}


def main() -> None:
    """Make the images named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="NAME", nargs="*", help=", ".join(PICTURES))
    parser.add_argument("--run", type=Path, help="for main_job or corrected: folder of such a run")
    options = parser.parse_args()
    for name in options.names:
        if name not in PICTURES:
            parser.error(f"no image named '{name}'; known: {', '.join(PICTURES)}")
    names = options.names or list(PICTURES)
    if len(names) > 1:  # a process each: the FEATURE-TASK's renderer and the simulator's need OpenGL in different ways
        if options.run:
            parser.error("--run needs the name of the one image that is made from the run")
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
