"""What is needed to repeat a run or a measurement: library versions and the machine."""

from __future__ import annotations

import os
import platform
import re
from importlib import metadata
from typing import Any

OWN = "icub-kit"
"""Distribution whose version, and whose requirements' versions, decide results."""


def versions() -> dict[str, str]:
    """Return the versions of Python, of this project and of the libraries it requires; absent ones are left out."""
    found = {"python": platform.python_version()}
    required = [
        re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in metadata.requires(OWN) or () if "extra ==" not in line
    ]
    for name in (OWN, *required):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """Return the number of usable cores and the name of the GPU, or None."""
    import torch

    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {"cores": len(os.sched_getaffinity(0)), "gpu": gpu}
