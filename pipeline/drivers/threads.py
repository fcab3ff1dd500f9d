"""Names for threads that `top -H` and a debugger show."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path


def name_this_thread(name: str) -> None:
    """Name the calling thread, for Python and (at most 15 characters) in /proc where it exists."""
    threading.current_thread().name = name
    name_thread(threading.get_native_id(), name)


def name_thread(tid: int, name: str) -> None:
    """Name any thread of this process by its native id, as above; a native one, too."""
    with contextlib.suppress(OSError):
        Path(f"/proc/self/task/{tid}/comm").write_text(name[:15])
