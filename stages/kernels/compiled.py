"""How the hot kernels are compiled: the one place that imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=np.generic)

#: Elements of four bytes in a cache line: what one `prefetch` brings.
LINE = 16


def compiled(kernel: F) -> F:
    """Compile a kernel on its first call, for one thread, without the GIL, cached on disk.

    Never parallel: on a machine whose cores are busy the barriers of a parallel kernel wait for
    preempted threads (measured ten times slower). No fastmath: results are bit-exact in the order
    of the code, which replay relies on.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(kernel)  # type: ignore[no-any-return]


def compiled_contracted(kernel: F) -> F:
    """The same, but a product and the sum that takes it may become one instruction, rounded once.

    For kernels that are arithmetic throughout: the order of the code still holds, and the same
    machine kind gives the same bits.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(kernel)  # type: ignore[no-any-return]


def _prefetch(to_write: bool) -> Any:
    """The processor's own instruction, for which neither Python nor numba has a word."""

    def prefetch(typing: Any, array: Any, index: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            number, void = cgutils.int32_t, cgutils.ir.VoidType()
            kind = cgutils.ir.FunctionType(void, [cgutils.voidptr_t, number, number, number])
            call = builder.module.declare_intrinsic(
                "llvm.prefetch", [cgutils.voidptr_t], kind
            )  # (address, 1 to write, 3: into all caches, 1: data)
            at = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
            builder.call(call, [at, number(int(to_write)), number(3), number(1)])
            return context.get_dummy_value()

        return numba.types.void(array, index), emit

    return intrinsic(prefetch)


#: ``prefetch(array, index)`` in a kernel starts to bring the cache line of an element of a
#: contiguous array (1-D or indexed flat) from memory and does not wait for it: where the next
#: addresses are known but not evenly spaced, the processor cannot guess them itself. An index out
#: of the array does no harm.
prefetch = _prefetch(to_write=False)

#: The same for a line that will be written.
prefetch_to_write = _prefetch(to_write=True)


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
