"""The state of a semantic voxel map: arrays that grow, a horizon, eviction, saving and loading."""

from __future__ import annotations

from collections import deque
from typing import IO, Any, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.kernels.compiled import as_input
from stages.kernels.horizon import (
    ENTRY,
    MAX_WINDOW,
    UNITS,
    add_entries,
    as_entries,
    find,
    fold,
    fold_positions,
    insert,
    merge_scan,
    push_entries,
    read_window,
    voxel_keys,
)
from stages.kernels.voxels import index_keys, unpack
from stages.types import CHANNELS, Cloud, SemanticVoxels

INITIAL_VOXELS = 1 << 16

#: Arrays grow by a quarter, which bounds what is held and unused: 131 bytes per voxel at most with
#: the infinite horizon (92 in the arrays, up to 16 in the table).
GROWTH = 1.25

#: Of saved maps; raised when older programs could not read them rightly.
FORMAT = 1

#: What a saved map needs to be made again.
SETTINGS = ("voxel_m", "classes", "horizon", "scans", "window_of", "merge")
NO_SCORES = as_input(np.zeros((0, CHANNELS), dtype=np.float32))
NO_SLOTS = np.zeros(0, dtype=np.int32)
NO_ENTRIES = np.zeros((0, ENTRY), dtype=np.int32)

Horizon = Literal["infinite", "window-drop", "window-then-infinite"]
WindowOf = Literal["map", "voxel"]


class VoxelMap:
    """Evidence of clouds by voxel of `voxel_m` m, for one thread.

    `horizon` says how long a scan counts: `infinite` forever; `window-drop` while it is one of the
    last `scans`; `window-then-infinite` forever as well, but the last `scans` can be read apart
    (``snapshot(recent=True)``).

    "The last n scans" has two readings. `window_of` "map": of the map (one queue of updates; a
    voxel that none of them hit is empty). "voxel": that hit the voxel, the paper's deque per voxel
    (a ring of entries each, 80 * n bytes per voxel; a voxel is never empty again).

    With `merge` "mean" a scan counts once per voxel, as the geometric mean of its points; the paper
    takes their product, as if points of one scan were independent.
    """

    def __init__(
        self,
        *,
        voxel_m: float,
        classes: int,
        horizon: Horizon = "infinite",
        scans: int = 10,
        window_of: WindowOf = "map",
        merge: Literal["product", "mean"] = "product",
    ) -> None:
        """Raises ValueError for a voxel size that is not above 0 or a window out of 1..31."""
        if not voxel_m > 0:
            raise ValueError(f"voxel_m must be above 0, not {voxel_m}")
        if not 1 <= scans <= MAX_WINDOW:
            raise ValueError(f"a horizon of {scans} scans: 1 to {MAX_WINDOW} can be kept apart")
        self.voxel_m = voxel_m
        self.classes = classes
        self.horizon = horizon
        self.scans = scans
        self.window_of = window_of
        self.merge = merge
        self.used = 0
        self.beyond = 0  #: points out of the map's reach so far
        self._first_stamp: int | None = None
        self._table = np.zeros(2 * INITIAL_VOXELS, dtype=np.int32)
        self._arrays = self._empty(INITIAL_VOXELS)
        self._queue: deque[tuple[NDArray[np.int32], NDArray[np.int32]]] = deque()

    @property
    def nbytes(self) -> int:
        """Bytes that the map holds."""
        queued = sum(slots.nbytes + entries.nbytes for slots, entries in self._queue)
        return self._table.nbytes + queued + sum(a.nbytes for a in self._arrays.values())

    def integrate(self, cloud: Cloud, map_from_sensor: NDArray[np.float64], stamp: int) -> None:
        """Take in the points with evidence; `map_from_sensor` (4, 4), `stamp` ns."""
        x, y, z = as_input(cloud.points.T)
        pose = as_input(np.asarray(map_from_sensor, dtype=np.float64))
        keys, inside = voxel_keys(x, y, z, as_input(cloud.evidence), pose, self.voxel_m)
        self.beyond += int(np.count_nonzero(keys == -2))
        voxels, rows, sums, counts = merge_scan(
            keys, inside, as_input(cloud.log_scores), self.classes, self.merge == "mean"
        )
        slots = self._slots_of(voxels)
        arrays = self._arrays
        arrays["seen_ms"][slots] = self._milliseconds(stamp)
        if self.horizon != "window-drop":
            fold_positions(slots, sums, counts, arrays["means"], arrays["hits"])
        if self.horizon == "infinite":
            fold(slots, rows, arrays["scores"], self.classes)
        else:
            self._slide(slots, as_entries(rows, sums, counts))

    def snapshot(self, *, recent: bool = False) -> SemanticVoxels:
        """The map as it stands, as arrays of its own; `recent`: only what the window holds."""
        if recent and self.horizon == "infinite":
            raise ValueError("an infinite horizon has no window; take window-then-infinite")
        arrays = {name: array[: self.used] for name, array in self._arrays.items()}
        windowed = recent or self.horizon == "window-drop"
        if windowed:
            kept: Any = np.flatnonzero(arrays["window"][:, 19])
            counts = arrays["window"][kept, 19]
            inside = arrays["window"][kept, 16:19] / (UNITS * counts[:, None])
        else:
            kept = slice(None)
            counts, inside = arrays["hits"].copy(), arrays["means"]
        if self.horizon == "infinite":
            scores = arrays["scores"].copy()
        else:
            forever = NO_SCORES if windowed else as_input(arrays["scores"])
            scores = read_window(as_input(arrays["window"][kept]), forever, self.classes)
        indices = unpack(arrays["keys"][kept])
        positions = ((indices + inside) * self.voxel_m).astype(np.float32)
        return SemanticVoxels(self.voxel_m, indices, positions, scores, counts)

    def evict(
        self,
        stamp: int,
        *,
        max_age_s: float = np.inf,
        center: NDArray[np.float64] | None = None,
        max_distance_m: float = np.inf,
    ) -> int:
        """Forget voxels last hit more than `max_age_s` before `stamp` or further than
        `max_distance_m` from `center` (3,) in the map; returns how many. Goes over the whole map.
        """
        keep = self._occupied()
        if np.isfinite(max_age_s):
            age_ms = self._milliseconds(stamp) - self._arrays["seen_ms"][: self.used].astype(
                np.int64
            )
            keep &= age_ms <= max_age_s * 1e3
        if center is not None and np.isfinite(max_distance_m):
            offset = (unpack(self._arrays["keys"][: self.used]) + 0.5) * self.voxel_m - center
            keep &= np.einsum("ij,ij->i", offset, offset) <= max_distance_m**2
        forgotten = int(np.count_nonzero(self._occupied() & ~keep))
        if forgotten:
            self._keep(keep)
        return forgotten

    def save(self, file: IO[bytes]) -> None:
        """Write everything as npz; `load` goes on where this map stands."""
        np.savez(file, **self.state())

    def state(self) -> dict[str, Any]:
        """Everything as arrays by name, to be saved; views of the map's own where they can be."""
        queue = list(self._queue)
        content: dict[str, Any] = {name: array[: self.used] for name, array in self._arrays.items()}
        for name in SETTINGS:
            content[name] = getattr(self, name)
        content["format"] = FORMAT
        content["beyond"] = self.beyond
        content["first_stamp"] = -1 if self._first_stamp is None else self._first_stamp
        content["queue_lengths"] = np.array([len(slots) for slots, _ in queue], dtype=np.int64)
        content["queue_slots"] = np.concatenate([s for s, _ in queue] or [NO_SLOTS])
        content["queue_entries"] = np.concatenate([e for _, e in queue] or [NO_ENTRIES])
        return content

    @classmethod
    def load(cls, file: IO[bytes] | str) -> VoxelMap:
        """A map that `save` wrote. Raises DataError for anything else."""
        try:
            with np.load(file, allow_pickle=False) as content:
                stored = {name: content[name] for name in content.files}
            if (form := stored.get("format", FORMAT)) != FORMAT:
                raise ValueError(f"its format is {form}, and {FORMAT} can be read")
            loaded = cls(**{name: stored.pop(name).item() for name in SETTINGS})
            loaded._restore(stored)
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
            raise DataError(f"not a saved voxel map ({error}); give one that was saved") from error
        return loaded

    def _restore(self, stored: dict[str, NDArray[Any]]) -> None:
        used = len(stored["keys"])
        self._arrays = self._empty(max(used, INITIAL_VOXELS))
        for name, array in self._arrays.items():
            if stored[name].shape != (used, *array.shape[1:]):
                raise ValueError(f"{name} has the shape {stored[name].shape}")
            array[:used] = stored[name]
        self.used = used
        self.beyond = int(stored["beyond"])
        self._first_stamp = None if stored["first_stamp"] < 0 else int(stored["first_stamp"])
        self._table = self._indexed(used)
        ends = np.cumsum(stored["queue_lengths"])[:-1]
        slots, entries = stored["queue_slots"], stored["queue_entries"]
        if len(slots) != len(entries) or not (slots < used).all():
            raise ValueError("its queue does not fit its voxels")
        if len(stored["queue_lengths"]):
            self._queue.extend(zip(np.split(slots, ends), np.split(entries, ends), strict=True))

    def _empty(self, voxels: int) -> dict[str, NDArray[Any]]:
        """Arrays by slot. Only what is used is ever touched, so only that takes memory."""
        arrays: dict[str, NDArray[Any]] = {
            "keys": np.empty(voxels, dtype=np.int64),
            "seen_ms": np.empty(voxels, dtype=np.int32),  # since the first cloud
        }
        if self.horizon != "window-drop":
            arrays["scores"] = np.empty((voxels, CHANNELS), dtype=np.float32)
            arrays["means"] = np.empty((voxels, 3), dtype=np.float32)  # 0..1 of the edge
            arrays["hits"] = np.empty(voxels, dtype=np.int32)
        if self.horizon != "infinite":
            arrays["window"] = np.empty((voxels, ENTRY), dtype=np.int32)
            if self.window_of == "voxel":
                arrays["ring"] = np.empty((voxels, self.scans, ENTRY), dtype=np.int32)
                arrays["pushed"] = np.empty(voxels, dtype=np.int32)
        return arrays

    def _slots_of(self, voxels: NDArray[np.int64]) -> NDArray[np.int32]:
        """The slots of voxels (m,), new ones cleared."""
        slots, missing = find(voxels, self._table, self._arrays["keys"])
        if missing:
            if self.used + missing > len(self._arrays["keys"]):
                self._grow(self.used + missing)
            if 2 * (self.used + missing) > len(self._table):
                self._table = self._indexed(self.used + missing)
            before = self.used
            self.used = insert(voxels, slots, before, self._table, self._arrays["keys"])
            for name, array in self._arrays.items():
                if name not in ("keys", "ring"):  # a ring is read only where it was written
                    array[before : self.used] = 0
            if "scores" in self._arrays:
                self._arrays["scores"][before : self.used, self.classes :] = np.float32(-1e4)
        return np.asarray(slots)

    def _slide(self, slots: NDArray[np.int32], entries: NDArray[np.int32]) -> None:
        """Put a scan's entries into the window; what leaves it is dropped or kept forever."""
        arrays = self._arrays
        if self.window_of == "voxel":
            left = push_entries(slots, entries, arrays["ring"], arrays["pushed"], arrays["window"])
            gone, left = slots[left[:, 19] > 0], left[left[:, 19] > 0]
        else:
            self._queue.append((slots, entries))
            add_entries(slots, entries, 1, arrays["window"])
            if len(self._queue) <= self.scans:
                return
            gone, left = self._queue.popleft()
            gone, left = gone[gone >= 0], left[gone >= 0]
            add_entries(gone, left, -1, arrays["window"])
        if self.horizon == "window-then-infinite":
            rows = left[:, :CHANNELS] / np.float32(UNITS)
            fold(gone, rows.astype(np.float32), arrays["scores"], self.classes)
        elif self.used > 2 * INITIAL_VOXELS and len(self._queue) == self.scans:
            occupied = self._occupied()
            if 2 * np.count_nonzero(occupied) < self.used:
                self._keep(occupied)

    def _occupied(self) -> NDArray[np.bool_]:
        if self.horizon == "window-drop":
            return np.asarray(self._arrays["window"][: self.used, 19] > 0)
        return np.ones(self.used, dtype=np.bool_)

    def _keep(self, keep: NDArray[np.bool_]) -> None:
        """Close the ranks: only the voxels `keep` (used,) stay, in their order."""
        place = np.where(keep, np.cumsum(keep) - 1, -1).astype(np.int32)
        old, kept = self._arrays, np.flatnonzero(keep)
        self._arrays = self._empty(max(int(GROWTH * len(kept)), INITIAL_VOXELS))
        for name, array in self._arrays.items():
            array[: len(kept)] = old[name][kept]
        self._queue = deque(
            (np.where(slots >= 0, place[slots], -1).astype(np.int32), entries)
            for slots, entries in self._queue
        )
        self.used = len(kept)
        self._table = self._indexed(self.used)

    def _grow(self, least: int) -> None:
        old = self._arrays
        self._arrays = self._empty(max(least, int(GROWTH * len(old["keys"]))))
        for name, array in self._arrays.items():
            array[: self.used] = old.pop(name)[: self.used]  # each is freed before the next grows

    def _indexed(self, voxels: int) -> NDArray[np.int32]:
        """A table at most half full with `voxels`, holding the used ones."""
        size = 2 * INITIAL_VOXELS
        while size < 2 * voxels:
            size *= 2
        table = np.zeros(size, dtype=np.int32)
        index_keys(self._arrays["keys"], self.used, table)
        return table

    def _milliseconds(self, stamp: int) -> int:
        """Since the first cloud, as it fits an int32 (24 days)."""
        if self._first_stamp is None:
            self._first_stamp = stamp
        return min(max((stamp - self._first_stamp) // 1_000_000, 0), 2**31 - 1)
