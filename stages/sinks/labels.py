"""Class ids as files: of clouds as SemanticKITTI lays them out, of fused images as gray PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.stage import Stage
from stages.fused import FusedImage
from stages.kernels.compiled import as_input
from stages.kernels.probability import read_out
from stages.kernels.render import encode_png
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Cloud


class WriteLabels(Stage):
    """Writes the class of each point of each cloud to `folder`/NNNNNN.label, a uint32 per point.

    Points without evidence are 0. NNNNNN is the frame: the stamp times `rate_hz`, as the sources of
    drives stamp their frames. A frame whose file this run wrote already is refused (StageError).
    """

    def __init__(
        self, *, folder: Path, rate_hz: float = 10.0, label_set: str | None = None
    ) -> None:
        """`label_set` of the taxonomy whose ids to write: of those that make up a class the first,
        0 where it has none. None: our own ids.
        """
        if not rate_hz > 0:
            raise ValueError(f"rate_hz must be above 0, not {rate_hz}")
        self._folder = Path(folder)
        self._rate_hz = rate_hz
        self._ids = ids_of(label_set)
        self._written: set[int] = set()

    def process(self, cloud: Message[Cloud]) -> None:
        frame = frame_of(cloud.stamp, self._rate_hz)
        if frame in self._written or frame < 0:
            raise StageError(
                f"the cloud at stamp {cloud.stamp} is frame {frame} at {self._rate_hz} Hz, "
                f"{'which is written' if frame >= 0 else 'before the first'}; set rate_hz to the "
                "rate of its source"
            )
        label, _, _ = read_out(as_input(cloud.payload.log_scores), len(load_taxonomy()))
        ids = self._ids[np.where(cloud.payload.evidence, label, 0)]
        with whole_file(self._folder / f"{frame:06d}.label") as file:
            file.write(ids.astype("<u4").tobytes())
        self._written.add(frame)


class WriteMasks(Stage):
    """Writes the mask of each fused image to `folder`/<stamp in ns>.png: the class id per pixel."""

    def __init__(self, *, folder: Path, by_camera: bool = False) -> None:
        """`by_camera` names the files <stamp>_<camera>.png: several cameras share the folder."""
        self._folder = Path(folder)
        self._by_camera = by_camera

    def process(self, fused: Message[FusedImage]) -> None:
        camera = f"_{fused.payload.camera}" if self._by_camera else ""
        with whole_file(self._folder / f"{fused.stamp:020d}{camera}.png") as file:
            file.write(encode_png(fused.payload.mask))


def frame_of(stamp: int, rate_hz: float) -> int:
    """The number of the frame at `stamp` ns, counted from 0 at stamp 0."""
    return round(stamp * rate_hz / 1e9)


def ids_of(label_set: str | None) -> NDArray[np.int64]:
    """(classes,) the id to write for each of our classes. Raises ValueError for no such set."""
    taxonomy = load_taxonomy()
    if label_set is None:
        return np.arange(len(taxonomy))
    taxonomy.label_map(label_set)  # says so where there is no such set
    theirs = taxonomy.maps[label_set]
    return np.array([theirs[name][0] if name in theirs else 0 for name in taxonomy.names])
