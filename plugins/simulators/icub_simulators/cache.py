"""A folder for what is expensive to compute and cheap to keep: convex pieces, decimated meshes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.files import cache_dir, write_atomically

Arrays = dict[str, NDArray]


def cache_folder(name: str) -> Path:
    """Return (and make) the folder `name` in the cache folder of the framework."""
    folder = cache_dir() / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def content_key(*parts: bytes | str | float | int | None) -> str:
    """Hash contents and parameters to a short name; any change of either gives another name."""
    digest = hashlib.sha256()
    for part in parts:
        raw = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(len(raw).to_bytes(8, "little") + raw)
    return digest.hexdigest()[:24]


def cached_arrays(folder: str, key: str, compute: Callable[[], Arrays]) -> Arrays:
    """Return the arrays kept under `key`, computing and keeping them the first time.

    Two processes may do so at once; a file that cannot be read back is computed again.
    """
    path = cache_folder(folder) / f"{key}.npz"
    if path.exists():
        try:
            with np.load(path, allow_pickle=False) as stored:
                return {name: stored[name] for name in stored.files}
        except (OSError, ValueError, EOFError, KeyError):
            path.unlink(missing_ok=True)
    arrays = compute()

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]

    write_atomically(path, write)
    return arrays
