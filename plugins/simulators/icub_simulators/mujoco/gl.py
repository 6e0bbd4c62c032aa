"""An OpenGL context without a screen, from whatever this machine has."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import logging
import os
from typing import Any

from icub_core.errors import SimulationError

logger = logging.getLogger(__name__)

_LIBRARIES = {"egl": ("EGL", "libEGL.so.1"), "osmesa": ("OSMesa", "libOSMesa.so.8")}
_INSTALL = "sudo apt-get install -y libegl1 libgl1 libgl1-mesa-dri"
VARIABLE = "MUJOCO_GL"


def choose_backend() -> str:
    """Return ``"egl"``, ``"osmesa"`` or what ``$MUJOCO_GL`` asks for; raises SimulationError where there is neither."""
    asked = os.environ.get(VARIABLE, "").strip().lower()
    if asked == "glfw":
        return asked
    if asked and asked not in _LIBRARIES:
        raise SimulationError(f"{VARIABLE} is '{asked}'; expected egl, osmesa or glfw")
    candidates = [asked] if asked else list(_LIBRARIES)
    for backend in candidates:
        if _library_exists(backend):
            return backend
    raise SimulationError(f"no OpenGL library for rendering ({' or '.join(candidates)}); install one: {_INSTALL}")


def make_context() -> Any:
    """Create an off-screen OpenGL context (with `make_current` and `free`).

    Raises:
        SimulationError: One line that says what to install.
    """
    backend = choose_backend()
    # MuJoCo's own loader and PyOpenGL both read the environment when they are first used
    os.environ[VARIABLE] = backend
    if backend in _LIBRARIES:
        os.environ["PYOPENGL_PLATFORM"] = backend
    try:
        module = importlib.import_module(f"mujoco.{backend}")
        context = module.GLContext(64, 64)  # pictures are drawn into a buffer of their own
        context.make_current()
    except Exception as error:  # PyOpenGL raises anything from AttributeError to its own classes
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise SimulationError(f"cannot open an OpenGL context with {backend} ({reason}); try: {_INSTALL}") from error
    logger.debug("rendering with %s", backend)
    return context


def _library_exists(backend: str) -> bool:
    short, soname = _LIBRARIES[backend]
    for name in (soname, ctypes.util.find_library(short)):
        if name is None:
            continue
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False
