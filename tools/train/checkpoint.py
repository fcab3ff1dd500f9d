"""The file that a training keeps: what it has learned, and how far it has come."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from pipeline.errors import DataError

CHECKPOINT = "checkpoint.pt"


@contextlib.contextmanager
def opened(path: Path, *, purpose: str, advice: str) -> Iterator[dict[str, Any]]:
    """What a checkpoint holds, to be used in the `with`. DataError where it is none, is broken, or
    does not fit what it is used for there: that it cannot `purpose`, and the way out."""
    try:
        yield torch.load(path, weights_only=True)
    except (RuntimeError, KeyError, EOFError, OSError, UnpicklingError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{path}: cannot {purpose} ({reason}); {advice}") from None
