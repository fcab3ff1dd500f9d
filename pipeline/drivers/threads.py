"""Names for threads that `top -H` and a debugger show."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path


def name_this_thread(name: str) -> None:
    """Name the calling thread, for Python and (at most 15 characters) in /proc where it exists."""
    threading.current_thread().name = name
    path = Path(f"/proc/self/task/{threading.get_native_id()}/comm")
    with contextlib.suppress(OSError):
        path.write_text(name[:15])
