"""A map on the disk that survives the process: written now and then, read back at the start."""

from __future__ import annotations

import logging
import os
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import DataError
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.voxel_map import SETTINGS, VoxelMap

log = logging.getLogger(__name__)


class MapCheckpoint:
    """Keeps the file `path` at most about `every_s` behind the map, in the time of its stamps.

    The map's thread only copies the arrays (0.8 ms at 100,000 voxels, 19 ms at a million, 120 ms at
    five); a thread of its own writes them, to a file beside that takes the name
    once it is whole and on the disk. While a write lasts no other begins, and `late` counts what
    was put off. A write that fails is told and counted in `failed`; the file before it stays.
    """

    def __init__(self, path: Path, every_s: float) -> None:
        self.path = path
        self.written = self.late = self.failed = 0
        self._every_ns = round(every_s * 1e9)
        self._due: int | None = None
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="map-checkpoint")
        self._writing: Future[None] | None = None

    def resume(self, fresh: VoxelMap) -> tuple[VoxelMap, int, int | None]:
        """The saved map, how many clouds it holds and the stamp of the last; `fresh` without file.

        Raises DataError for a file that is no checkpoint, or one of a map with other settings.
        """
        for leftover in self.path.parent.glob(f".{self.path.name}.*"):  # of a killed writer
            leftover.unlink()
        if not self.path.exists():
            return fresh, 0, None
        try:
            with self.path.open("rb") as file:
                saved = VoxelMap.load(file)
                file.seek(0)
                content = np.load(file, allow_pickle=False)
                clouds, stamp = int(content["clouds"]), int(content["stamp"])
                names = tuple(content["class_names"])
        except (DataError, KeyError, OSError) as error:
            raise DataError(
                f"checkpoint {self.path}: cannot go on from it: {error}; move it away to begin anew"
            ) from error
        for name in SETTINGS:
            before, now = getattr(saved, name), getattr(fresh, name)
            if before != now:
                raise DataError(
                    f"checkpoint {self.path}: its map has {name} {before}, the graph says {now}; "
                    "set that, or move the file away to begin anew"
                )
        if names != load_taxonomy().names:
            raise DataError(
                f"checkpoint {self.path}: its classes are others than the taxonomy's; move the "
                "file away to begin anew"
            )
        log.info("the map goes on from %s: %d voxels, %d clouds", self.path, saved.used, clouds)
        return saved, clouds, stamp

    def offer(self, current: VoxelMap, clouds: int, stamp: int) -> None:
        """Begin to write the map as it is now, if it is time."""
        if self._due is None:
            self._due = stamp + self._every_ns
        if stamp < self._due:
            return
        if self._writing is not None and not self._writing.done():
            self.late += 1
            return
        self._due = stamp + self._every_ns
        copied = {name: np.array(array) for name, array in current.state().items()}
        self._writing = self._writer.submit(self._write_or_tell, copied, clouds, stamp)

    def close(self, current: VoxelMap, clouds: int, stamp: int | None) -> None:
        """Write the map as it ends. Raises DataError where that fails."""
        self._writer.shutdown(wait=True)
        if stamp is not None:
            self._write(current.state(), clouds, stamp)

    def _write_or_tell(self, state: dict[str, Any], clouds: int, stamp: int) -> None:
        try:
            self._write(state, clouds, stamp)
        except (DataError, OSError) as error:
            self.failed += 1
            log.warning("checkpoint %s was not written: %s", self.path, error)

    def _write(self, state: dict[str, Any], clouds: int, stamp: int) -> None:
        names = np.array(load_taxonomy().names)
        with whole_file(self.path) as file:
            np.savez(file, **state, clouds=clouds, stamp=stamp, class_names=names)
            file.flush()
            os.fsync(file.fileno())  # a drone may lose its power right after the rename
        self.written += 1
