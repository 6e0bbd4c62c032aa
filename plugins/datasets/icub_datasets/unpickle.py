"""Reading pickles of public data sets without letting them run anything."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from icub_core.errors import DataError

_ARRAYS = {
    (f"numpy.{core}.{module}", name)
    for core in ("core", "_core")
    for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
}
_ALLOWED = _ARRAYS | {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode")}
MAX_BYTES = 256 * 2**20


class _Restricted(pickle.Unpickler):
    """Builds numbers, strings, containers and numpy arrays; refuses every other name."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        if module == "numpy":
            return getattr(np, name)
        if module == "_codecs":
            return _encode_latin1
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def _encode_latin1(text: str, encoding: str = "latin1") -> bytes:
    """Stand in for `_codecs.encode`, which protocol 2 uses to carry bytes, for the one encoding that is needed."""
    if encoding.lower() not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"it asks for the encoding {encoding}")
    return text.encode("latin1")


def load_plain_pickle(path: Path) -> Any:
    """Load a pickle that holds only numbers, strings, containers and numeric numpy arrays (Python 2's too).

    Raises:
        DataError: Missing, larger than 256 MiB, truncated, or holding anything else.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path} has {path.stat().st_size} bytes; expected at most {MAX_BYTES}")
        content = path.read_bytes()
        value = _Restricted(io.BytesIO(content), encoding="latin1").load()
    except OSError as error:
        raise DataError(f"cannot read {path}: {(error.strerror or str(error)).lower()}") from error
    except DataError:
        raise
    except Exception as error:  # the opcodes of a damaged pickle raise almost anything
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{path} is not a pickle of plain numbers and arrays: {reason}") from error
    return value
