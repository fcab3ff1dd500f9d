"""What this process has open, by name: threads of other tests may close theirs at any time."""

from __future__ import annotations

import contextlib
from collections import Counter
from pathlib import Path


def descriptors(within: str = "") -> Counter[str]:
    """The names of open descriptors that hold these words; sockets and pipes have one each.

    ``descriptors() - before`` is what was opened since, whatever was closed.
    """
    names: Counter[str] = Counter()
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since
            name = str(path.readlink())
            names[name] += within in name and not name.startswith("/proc/")  # not our own look
    return +names
