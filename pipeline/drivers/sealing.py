"""Makes the arrays of a payload read-only when it is handed out, so that receivers can share it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np


def seal(payload: Any) -> None:
    """Clear the write flag of every array that the payload is, or holds in a field.

    No copy is made. A stage that goes on writing into an array it has handed out gets numpy's
    "assignment destination is read-only" at once, instead of its receivers a torn frame.
    """
    if isinstance(payload, np.ndarray):
        payload.setflags(write=False)
        return
    for name in _field_names(type(payload)):  # type: ignore[arg-type]  # classes are hashable
        value = getattr(payload, name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()
