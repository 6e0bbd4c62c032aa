"""The cache folder for generated files: content-addressed, written atomically, safe to delete at any time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from icub_core.errors import CheckpointError, DataError
from icub_core.files import cache_dir, write_bytes_atomically


def store_text(text: str, stem: str, suffix: str) -> Path:
    """Keep `text` in a file named after its content and return the path.

    The same text always gives the same path, and a reader meets either no file or the whole one. A file that was
    damaged since is written again.

    Raises:
        DataError: The folder cannot be written.
    """
    content = text.encode()
    path = cache_dir() / f"{stem}-{_digest(content)}{suffix}"
    if _read(path) != content:
        _write(path, content)
    return path


def store_derived(source: bytes, derive: Callable[[], bytes], stem: str, suffix: str) -> Path:
    """Keep what `derive` makes of `source` in a file named after the source; derive only when it is not there.

    Raises:
        DataError: The folder cannot be written.
    """
    path = cache_dir() / f"{stem}-{_digest(source)}{suffix}"
    if not path.is_file():
        _write(path, derive())
    return path


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _write(path: Path, content: bytes) -> None:
    try:
        write_bytes_atomically(path, content)
    except CheckpointError as error:
        reason = str(error).split("; ")[0]
        raise DataError(f"{reason}; set ICUB_CACHE to a folder that can be written") from error
