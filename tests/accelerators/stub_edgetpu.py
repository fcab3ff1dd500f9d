"""Compiles the stub delegate library, so that the whole path to an Edge TPU runs without one."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

SOURCE = Path(__file__).with_suffix(".c")
FOLDER = TemporaryDirectory(prefix="stub_edgetpu_")  #: gone with the tests


@cache
def _compiled() -> Path | None:
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    library = Path(FOLDER.name) / "libstub_edgetpu.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(library), str(SOURCE)], check=True)
    return library


def stub_library() -> str:
    """The path of the compiled library; skips the test where there is no C compiler."""
    library = _compiled()
    if library is None:
        pytest.skip("needs a C compiler to build the stub delegate; install gcc")
    return str(library)


def stub() -> Any:
    """The library itself, to look into it."""
    library = ctypes.CDLL(stub_library())
    library.stub_options.restype = ctypes.c_char_p
    return library
