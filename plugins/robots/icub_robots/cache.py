"""The cache folder for generated files: content-addressed, written atomically, safe to delete at any time."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

from icub_core.errors import DataError


def cache_dir() -> Path:
    """Return ``$XDG_CACHE_HOME/icub-kit``, or ``~/.cache/icub-kit``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "icub-kit"


def store_text(text: str, stem: str, suffix: str) -> Path:
    """Keep `text` in a file named after its content and return the path.

    The same text always gives the same path, and a reader meets either no file or the whole one: it is written aside
    and renamed. A file that was damaged since is written again.

    Raises:
        DataError: The folder cannot be written.
    """
    content = text.encode()
    path = cache_dir() / f"{stem}-{hashlib.sha256(content).hexdigest()[:16]}{suffix}"
    try:
        if path.is_file() and path.read_bytes() == content:
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise DataError(
            f"cannot write {path}: {error.strerror}; set XDG_CACHE_HOME to a folder that can be written"
        ) from error
    return path
