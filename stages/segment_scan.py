"""Class scores of a LiDAR scan's points, from a network on its range image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from numpy.typing import NDArray

from pipeline.errors import DataError, ModelError
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage
from stages.kernels.class_groups import grouped_log_scores, membership
from stages.kernels.compiled import as_input
from stages.kernels.probability import softmax
from stages.kernels.range_image import (
    fill_channels,
    organized_cells,
    project_scan,
    ranges,
    rows_by_cell,
    rows_by_neighbors,
)
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, PADDING_LOG, Cloud, Scan

#: The statistics that come with Overflight.
SHIPPED = Path(__file__).with_name("scan_statistics.yaml")

NO_REMISSION = as_input(np.zeros(0, dtype=np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class ScanStatistics:
    """The field of view of a range image and what its channels are normalized with."""

    elevation_rad: tuple[float, float]  #: of the lowest and the highest row's outer edge
    mean: NDArray[np.float32]  #: (5,) range, x, y, z in m, remission 0..1
    std: NDArray[np.float32]  #: (5,)

    @classmethod
    def read(cls, file: Path, sensor: str) -> ScanStatistics:
        """The entry `sensor` of a statistics file. Raises DataError with what is wrong."""
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
            if sensor not in content:
                raise DataError(f"{file}: no sensor '{sensor}' (known: {', '.join(content)})")
            entry = content[sensor]
            lowest, highest = (float(np.radians(angle)) for angle in entry["elevation_deg"])
            mean, std = (np.array(entry[name], dtype=np.float32) for name in ("mean", "std"))
        except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            raise DataError(
                f"{file}: no scan statistics ({error!r}); see {SHIPPED.name}"
            ) from error
        if mean.shape != (5,) or std.shape != (5,) or not (std > 0).all():
            raise DataError(f"{file}: {sensor}: mean and std take 5 numbers, std above 0")
        if not lowest < highest:
            raise DataError(f"{file}: {sensor}: elevation_deg is [lowest, highest]")
        return cls((lowest, highest), mean, std)


class SegmentScan(ModelStage):
    """Points with the log scores of a network that sees the scan as a range image (eq 18).

    An organized scan whose rows and columns are a whole multiple of the network's is taken row by
    row and column by column; any other is projected. Points out of the field of view or without a
    return get no evidence, and neither does a point whose cell has none.

    `neighbors` cleans up around edges: a point takes the mean of the cells near it in range, not
    the scores of its cell, at about 12 ms per 131,072 points. `temperature` above 1 makes an
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
        self._statistics = ScanStatistics.read(self._file, self._sensor)
        self._cells: dict[tuple[int, int], tuple[NDArray[np.int32], NDArray[np.int32]]] = {}
        # Compiles the kernels (or loads them from the cache) now, not during the first scan.
        rows, columns, _ = self.model.input_shape
        one = np.ones((1, 3), dtype=np.float32)
        outputs = {"scores": Tensor(np.zeros((1, rows, columns, CHANNELS), dtype=np.float32))}
        groups_of_warm_up, self._groups = self._groups, {}
        warm_up = Message.at(0, Scan(one, one[:, 0], None, None, ""))
        self.prepare(warm_up)
        ranges(as_input(one))
        self.finish(outputs, warm_up)
        self._groups = groups_of_warm_up

    def prepare(self, scan: Message[Scan]) -> Tensors:
        payload = scan.payload
        points = as_input(payload.points)
        nearest, _, _ = self._place(payload, points)
        channels = self.model.input_shape[2]
        remission = NO_REMISSION if payload.remission is None else as_input(payload.remission)
        image, _ = fill_channels(
            points,
            remission,
            as_input(nearest),
            as_input(self._statistics.mean[:channels]),
            as_input(self._statistics.std[:channels]),
        )
        return {self.model.input_name: Tensor(image[None])}

    def finish(self, outputs: Tensors, scan: Message[Scan]) -> Cloud:
        payload = scan.payload
        # Placed a second time: cheaper (0.1 ms organized, 0.4 ms projected) than to remember runs.
        nearest, cell, distance = self._place(payload, as_input(payload.points))
        measured = np.zeros(nearest.shape, dtype=np.float32)
        if len(distance):
            measured = np.where(nearest >= 0, distance[nearest], measured)
        scores = self._log_scores(outputs["scores"].values())
        if scores.shape[:2] != nearest.shape:
            raise ModelError(
                f"model '{self.model.name}' answers {scores.shape[:2]} cells for {nearest.shape}"
            )
        back = (as_input(measured), as_input(cell), as_input(distance), self._classes)
        if self._back == "neighbors":
            probabilities = np.zeros((*nearest.shape, CHANNELS), dtype=np.float32)
            probabilities[..., : self._classes] = softmax(scores, self._classes)
            rows, said = rows_by_neighbors(as_input(probabilities), *back)
        else:
            rows, said = rows_by_cell(as_input(scores), *back)
        return Cloud(
            payload.points, rows, said, None, payload.sensor, payload.times_ns, payload.shape
        )

    def _place(
        self, scan: Scan, points: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
        """The point of each cell, the cell of each point and its range, as `project_scan`."""
        rows, columns, _ = self.model.input_shape
        shape = scan.shape
        if self._organized and shape and shape[0] % rows == 0 and shape[1] % columns == 0:
            if shape not in self._cells:
                self._cells[shape] = organized_cells(shape, (rows, columns))
            nearest, cell = self._cells[shape]
            distance = ranges(points)
            return nearest, cell, np.where(distance <= self._max_range_m, distance, np.float32(0))
        return project_scan(
            points, (rows, columns), self._statistics.elevation_rad, self._max_range_m
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
        return np.asarray(output[0] / np.float32(self._temperature), dtype=np.float32)
