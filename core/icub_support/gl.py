"""An OpenGL context without a screen, from whatever this machine has."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import importlib.util
import logging
import os
import sys
from pathlib import Path
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


def make_context(library: str) -> Any:
    """Create an off-screen OpenGL context (with `make_current` and `free`); see `prepare`.

    Raises:
        SimulationError: One line that says what to install.
    """
    context_class = prepare(library)
    try:
        context = context_class(64, 64)  # images are drawn into a buffer of their own
        context.make_current()
    except Exception as error:  # PyOpenGL raises anything from AttributeError to its own classes
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        backend = os.environ[VARIABLE]
        raise SimulationError(f"cannot open an OpenGL context with {backend} ({reason}); try: {_INSTALL}") from error
    logger.debug("rendering with %s", os.environ[VARIABLE])
    return context


def prepare(library: str) -> Any:
    """Choose a backend, set the process up for it, and return a library's class of contexts for it.

    Args:
        library: Package with a module of a class `GLContext` for each backend, as MuJoCo has.

    Raises:
        SimulationError: One line that says what to install.
    """
    backend = choose_backend()
    _load_triton_first()
    # the library's own loader and PyOpenGL both read the environment when they are first used
    os.environ[VARIABLE] = backend
    if backend in _LIBRARIES:
        os.environ["PYOPENGL_PLATFORM"] = backend
    # Mesa's software driver: handing a small image to worker threads takes longer than drawing it
    os.environ.setdefault("LP_NUM_THREADS", "0")
    try:
        return importlib.import_module(f"{library}.{backend}").GLContext
    except Exception as error:
        raise SimulationError(f"{library} cannot use {backend} here: {error}; try: {_INSTALL}") from error


def _load_triton_first() -> None:
    """Load Triton's library before Mesa's, where Triton is installed (it comes with torch).

    Both contain an LLVM. Loaded after Mesa's software driver, Triton's binds to the driver's, and the process dies of
    a segmentation fault, typically when `tensordict` is imported after the first image was drawn. The other way
    round both work. Only the library is loaded, not the package.
    """
    spec = importlib.util.find_spec("triton") if "triton" not in sys.modules else None
    if spec is None or spec.origin is None:
        return
    for library in (Path(spec.origin).parent / "_C").glob("libtriton*.so"):
        try:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_LOCAL)
        except OSError as error:
            logger.debug("Triton's library is left alone: %s", error)


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
