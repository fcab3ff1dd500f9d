"""How the hot kernels are compiled: the one place that imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=np.generic)


def compiled(kernel: F) -> F:
    """Compile a kernel on its first call, for one thread, without the GIL, cached on disk.

    Never parallel: on a machine whose cores are busy the barriers of a parallel kernel wait for
    preempted threads (measured ten times slower). No fastmath: results are bit-exact in the order
    of the code, which replay relies on.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(kernel)  # type: ignore[no-any-return]


def as_input(array: NDArray[T]) -> NDArray[T]:
    """The array as a kernel takes what it only reads: a view that is read-only and contiguous.

    Senders lock their arrays or do not, and numba compiles a kernel once for each kind: a second
    kind would cost the first message that brings it up to a second.
    """
    return locked(np.ascontiguousarray(array))


def locked(array: NDArray[T]) -> NDArray[T]:
    """A read-only view in the array's own strides, for inputs too large to be made contiguous."""
    view = array.view()
    view.flags.writeable = False
    return view
