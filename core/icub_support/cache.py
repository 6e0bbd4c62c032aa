"""Files that are expensive to compute and cheap to keep, such as convex pieces and assembled robot models.

They lie in the cache folder of the framework under names made from what they depend on, are written atomically, and
may be deleted at any time. Every function raises DataError where that folder cannot be written.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import CheckpointError, DataError
from icub_core.files import cache_dir, write_atomically

Arrays = dict[str, NDArray]


def content_key(*parts: bytes | str | float | int | None) -> str:
    """Hash contents and parameters to a short name; any change of either gives another name."""
    digest = hashlib.sha256()
    for part in parts:
        raw = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(len(raw).to_bytes(8, "little") + raw)
    return digest.hexdigest()[:24]


def cached_file(folder: str, name: str, compute: Callable[[], bytes]) -> Path:
    """Return the file `name` of a folder of the cache; `compute` gives its content when it is not there yet."""
    path = cache_dir() / folder / name
    if not path.is_file():
        content = compute()
        _write(path, lambda temporary: temporary.write_bytes(content))
    return path


def cached_text(folder: str, text: str, suffix: str) -> Path:
    """Return a file that holds `text`, named after its content; a damaged file is written again."""
    content = text.encode()
    path = cache_dir() / folder / f"{content_key(text)}{suffix}"
    try:
        whole = path.read_bytes() == content
    except OSError:
        whole = False
    if not whole:
        _write(path, lambda temporary: temporary.write_bytes(content))
    return path


def cached_arrays(folder: str, key: str, compute: Callable[[], Arrays]) -> Arrays:
    """Return the arrays kept under `key`; they are computed the first time and when they cannot be read back."""
    path = cache_dir() / folder / f"{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, BadZipFile):
        arrays = compute()

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]

    _write(path, write)
    return arrays


def _write(path: Path, write: Callable[[Path], object]) -> None:
    try:
        write_atomically(path, write)
    except CheckpointError as error:
        reason = str(error).split("; ")[0]
        raise DataError(f"{reason}; set ICUB_CACHE to a folder that can be written") from error
