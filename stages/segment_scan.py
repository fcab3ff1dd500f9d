"""Class scores of a LiDAR scan's points, from a network on its range image."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ModelError
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage
from stages.kernels.class_groups import grouped_log_scores, membership
from stages.kernels.compiled import as_input
from stages.kernels.probability import softmax
from stages.kernels.scan_scores import rows_by_cell, rows_by_neighbors
from stages.scan_image import RangeImage
from stages.scan_statistics import SHIPPED, ScanStatistics
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, PADDING_LOG, Cloud, Scan


class SegmentScan(ModelStage):
    """Points with the log scores of a network that sees the scan as a range image (eq 18).

    An organized scan whose rows and columns are a whole multiple of the network's, and that looks
    where its image does, is taken row by row and column by column; any other is projected (see
    `RangeImage`). Points out of the field of view or without a return get no evidence.

    `back: cell` gives a point the scores of its cell, and none where the cell has no return.
    `neighbors` cleans up around edges: a point takes the mean of the cells near it in space, its
    own cell among them or not, at about 10 ms per 131,072 points. `temperature` above 1 makes an
    overconfident network milder. Without a class map the network's channels are ours.
    """

    stateless = True

    def __init__(
        self,
        *,
        sensor: str = "os0_128",
        statistics: Path = SHIPPED,
        back: Literal["cell", "neighbors"] = "cell",
        organized: bool = True,
        max_range_m: float = 200.0,
        temperature: float = 1.0,
    ) -> None:
        """`sensor` names an entry of the `statistics` file; `organized: false` projects always."""
        if not temperature > 0:
            raise ValueError(f"temperature must be above 0, not {temperature}")
        if not max_range_m > 0:
            raise ValueError(f"max_range_m must be above 0, not {max_range_m}")
        self._sensor = sensor
        self._file = Path(statistics)
        self._back = back
        self._organized = organized
        self._max_range_m = max_range_m
        self._temperature = temperature
        self._classes = len(load_taxonomy())

    def open(self) -> None:
        name, head = self.model.name, self.model.head
        if head["kind"] != "scores":
            raise ModelError(
                f"model '{name}' has a head of kind '{head['kind']}'; SegmentScan takes 'scores'"
            )
        if len(self.model.input_shape) != 3 or self.model.input_shape[2] not in (4, 5):
            raise ModelError(
                f"model '{name}' takes {self.model.input_shape}; "
                "SegmentScan gives (rows, columns, 4 or 5)"
            )
        taxonomy = load_taxonomy()
        try:
            groups = (head.get("class_map") or {}).items()
            self._groups = {theirs: taxonomy.id(ours) for theirs, ours in groups}
        except ValueError as error:
            raise ModelError(f"model '{name}': class_map: {error}") from None
        statistics = ScanStatistics.read(self._file, self._sensor)
        rows, columns, depth = self.model.input_shape
        self._mean, self._std = statistics.mean[:depth], statistics.std[:depth]
        self._image = RangeImage(
            (rows, columns),
            statistics.elevation_rad,
            self._max_range_m,
            organized=self._organized,
        )
        # Compiles the kernels (or loads them from the cache) now, not during the first scan.
        nothing = Tensor(np.zeros((1, rows, columns, CHANNELS), dtype=np.float32))
        groups, self._groups = self._groups, {}
        for shape in ((rows, columns), None):
            points = np.ones((rows * columns, 3), dtype=np.float32)
            warm_up = Message.at(0, Scan(points, points[:, 0], None, shape, ""))
            self.prepare(warm_up)
            self.finish({"scores": nothing}, warm_up)
        self._groups = groups

    def prepare(self, scan: Message[Scan]) -> Tensors:
        channels = self._image.channels(scan.payload, self._mean, self._std)
        # In the network's own planes, seen as (rows, columns, channels).
        return {self.model.input_name: Tensor(channels.transpose(1, 2, 0)[None])}

    def finish(self, outputs: Tensors, scan: Message[Scan]) -> Cloud:
        payload = scan.payload
        # Placed a second time: cheaper (0.1 ms organized, 0.4 ms projected) than to remember runs.
        nearest, cell, distance = self._image.places(payload)
        scores = self._log_scores(outputs["scores"].values())
        if scores.shape[:2] != nearest.shape:
            raise ModelError(
                f"model '{self.model.name}' answers {scores.shape[:2]} cells for {nearest.shape}"
            )
        back = (as_input(nearest), as_input(cell), as_input(distance))
        if self._back == "neighbors":
            probabilities = np.zeros((*nearest.shape, CHANNELS), dtype=np.float32)
            probabilities[..., : self._classes] = softmax(scores, self._classes)
            rows, said = rows_by_neighbors(
                as_input(probabilities), *back, as_input(payload.points), self._classes
            )
        else:
            rows, said = rows_by_cell(as_input(scores), *back, self._classes)
        return Cloud(
            payload.points, rows, said, None, payload.sensor, payload.times_ns, payload.shape
        )

    def _log_scores(self, output: NDArray[np.float32]) -> NDArray[np.float32]:
        """Our log scores (rows, columns, CHANNELS) of the output (1, rows, columns, k)."""
        if self._groups:
            return grouped_log_scores(
                output[0],
                membership(self._groups, output.shape[-1], CHANNELS),
                self._classes,
                temperature=self._temperature,
                padding=float(PADDING_LOG),
            )
        if output.shape[-1] != CHANNELS:
            raise ModelError(
                f"model '{self.model.name}' has {output.shape[-1]} channels; "
                f"without a class_map it needs the taxonomy's {CHANNELS}"
            )
        if self._temperature == 1.0:
            return np.asarray(output[0])
        return np.asarray(output[0] / np.float32(self._temperature))
