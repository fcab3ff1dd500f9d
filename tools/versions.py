"""Which versions run here: Overflight's own, Python's, and those of what it stands on."""

from __future__ import annotations

import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version


def own_version() -> str:
    """The version of the installed distribution."""
    return version("overflight")


def versions() -> dict[str, str | None]:
    """By distribution, for a benchmark's head or a bug report; None where it is not installed."""
    found: dict[str, str | None] = {
        "overflight": own_version(),
        "python": platform.python_version(),
    }
    for requirement in requires("overflight") or ():
        if "extra ==" in requirement:
            continue
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found
