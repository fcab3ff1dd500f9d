"""How right a scan network is: its file, run as in a graph, against the class of each point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelerators.registry import Registry
from pipeline.message import Message
from pipeline.model import BoundModel
from stages.kernels.metrics import WIDTH, confusion
from stages.scan_statistics import SHIPPED
from stages.segment_scan import SegmentScan
from stages.types import CHANNELS, Scan
from tools.evaluate_detections import open_model


@dataclass(frozen=True, slots=True)
class ScanNetwork:
    """A model and how scans are prepared for it."""

    model: BoundModel
    stage: SegmentScan

    @classmethod
    def open(
        cls,
        registry: Path | None,
        sensor: str,
        statistics: Path = SHIPPED,
        *,
        name: str = "segment-scan",
        organized: bool = True,
    ) -> ScanNetwork:
        """The OpenVINO file of a training, or the shipped one; points take the scores of the cells
        near them, the clean-up that SalsaNext is published with. Raises OverflightError."""
        registries = () if registry is None else (registry,)
        bound, _ = open_model(Registry.open(*registries), name, "openvino")
        stage = SegmentScan(
            sensor=sensor, statistics=statistics, back="neighbors", organized=organized
        )
        stage.model = bound.spec
        stage.open()
        return cls(bound, stage)

    def scores(self, scan: Scan) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """(n, CHANNELS) log scores of its points, and for which (n,) it has some."""
        message = Message.at(0, scan)
        outputs = self.model.infer(self.model.encode(self.stage.prepare(message)))
        cloud = self.stage.finish(self.model.decode(outputs), message)
        return cloud.log_scores, cloud.evidence

    def classes(self, scan: Scan) -> NDArray[np.int64]:
        """(n,) the likeliest class of each point but background, 0 where nothing is said."""
        scores, said = self.scores(scan)
        best = 1 + scores[:, 1:CHANNELS].argmax(axis=1)
        return np.where(said, best, 0).astype(np.int64)


def judge(
    network: ScanNetwork, scans: Iterable[tuple[Scan, NDArray[np.uint8]]]
) -> NDArray[np.int64]:
    """The confusion (16, 16), by truth and prediction, over scans with the class of each point."""
    total = np.zeros((WIDTH, WIDTH), dtype=np.int64)
    for scan, truth in scans:
        total += confusion(truth, network.classes(scan))
    return total
