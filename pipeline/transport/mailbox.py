"""Calls between two processes of one host: a header over a socket, arrays in shared memory.

Calls and answers alternate, so each side owns one area of shared memory that only it writes. The
area has no name (a memfd): it is gone when both processes are, however they end. Nothing is
pickled; a header is JSON and at most `HEADER_BYTES` long.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import select
import socket
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The most that a header takes; the socket carries each as one packet.
HEADER_BYTES = 128 * 1024
#: Arrays start at multiples of this: a cache line, which every runtime accepts.
ALIGN = 64

Arrays = Mapping[str, NDArray[Any]]


class Closed(Exception):
    """The other process is gone, or has closed its end."""


class Mailbox:
    """One end of a pair. Not thread-safe."""

    def __init__(self, end: socket.socket, timeout_s: float | None = None) -> None:
        """`timeout_s`: the longest that the other side may take to answer; None: for ever."""
        end.settimeout(timeout_s)
        self._socket = end
        self._out: mmap.mmap | None = None  #: our area
        self._in: mmap.mmap | None = None  #: the other side's

    def send(self, header: Mapping[str, Any], arrays: Arrays | None = None) -> None:
        """Send a header and named arrays. Raises Closed; ValueError for too long a header."""
        layout: dict[str, Any] = {}
        end = 0
        for name, array in (arrays or {}).items():
            start = -(-end // ALIGN) * ALIGN
            layout[name] = [array.dtype.str, list(array.shape), start]
            end = start + max(array.nbytes, 1)
        packet = json.dumps({**header, "arrays": layout}).encode()
        if len(packet) > HEADER_BYTES:
            raise ValueError(f"a header of {len(packet)} bytes; at most {HEADER_BYTES} go")
        descriptors = [] if end <= len(self._out or b"") else [self._grow(end)]
        for name, array in (arrays or {}).items():
            dtype, shape, start = layout[name]
            assert self._out is not None
            _view(self._out, dtype, shape, start)[...] = array
        try:
            socket.send_fds(self._socket, [packet], descriptors)
        except OSError as error:
            raise Closed(str(error)) from None
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def readable(self) -> bool:
        """Whether `receive` would not wait."""
        return bool(select.select([self._socket], [], [], 0)[0])

    def receive(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Wait for a header and its arrays, copied. Raises Closed, also for what is none."""
        try:
            packet, descriptors, _, _ = socket.recv_fds(self._socket, HEADER_BYTES, 1)
        except OSError as error:
            raise Closed(str(error)) from None
        if not packet:
            raise Closed("the other process has ended")
        try:
            for descriptor in descriptors:
                if self._in is not None:
                    self._in.close()
                self._in = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
                os.close(descriptor)
            header = json.loads(packet)
            layout = header.pop("arrays")
            arrays = {name: self._copy(*place) for name, place in layout.items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise Closed(f"the other process sent what is no header: {error}") from None
        return header, arrays

    def close(self) -> None:
        """Close this end; a receiver on the other gets Closed."""
        with contextlib.suppress(OSError):  # wakes a receiver on this end, too
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for area in (self._out, self._in):
            if area is not None:
                area.close()
        self._out = self._in = None

    def _grow(self, needed: int) -> int:
        """A new area of at least `needed` bytes; its descriptor goes with the next header."""
        size = max(needed, mmap.PAGESIZE)
        if self._out is not None:
            size = max(size, 2 * len(self._out))
            self._out.close()
        descriptor = os.memfd_create("overflight")
        os.ftruncate(descriptor, size)
        self._out = mmap.mmap(descriptor, size)
        return descriptor

    def _copy(self, dtype: str, shape: list[int], start: int) -> NDArray[Any]:
        if self._in is None:
            raise ValueError("arrays before any memory")
        return _view(self._in, dtype, shape, start).copy()


def _view(memory: mmap.mmap, dtype: str, shape: list[int], start: int) -> NDArray[Any]:
    """The array in an area; ValueError where it would not lie inside."""
    kind = np.dtype(dtype)
    if kind.hasobject or min(shape, default=0) < 0 or start < 0:
        raise ValueError(f"no array of {dtype} {shape} at {start}")
    count = prod(shape)
    return (
        np.frombuffer(memory, kind, count, start).reshape(shape) if count else np.empty(shape, kind)
    )
