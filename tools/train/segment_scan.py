"""`overflight train segment-scan` on a flight with ground truth; `scan_training` takes mixtures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from stages.kernels.compiled import as_input
from stages.labels import Labels
from stages.scan_image import RangeImage
from stages.scan_statistics import ScanStatistics
from stages.types import CHANNELS, Scan
from tools.train.balance import balance
from tools.train.flights import with_truth
from tools.train.plan import Order, Plan, carry_out
from tools.train.products import SAMPLES
from tools.train.salsanext import SalsaNext
from tools.train.scan_network import RATE, SIZE, calibration, meaning_of_scans
from tools.train.segmenter import LabeledScan, ScanSegmenter

#: Up to this share of the returns are taken away in training: the sensor is the same, some of its
#: returns are lost.
LOST = 0.2
#: Beyond it a simulated scan has no return either.
MAX_RANGE_M = 200.0


def train_scan_segmenter(
    order: Order, width: float, statistics: Path, sensor: str, console: Console
) -> Path:
    """SalsaNext on the LiDARs of a flight; its registry. Raises OverflightError, Interrupted."""
    entry = ScanStatistics.read(statistics, sensor)
    scans = read_scans(order.data, entry.elevation_rad)
    torch.manual_seed(order.seed)
    network = SalsaNext(CHANNELS, width=width)
    task = ScanSegmenter(network, scans, entry.mean, entry.std, lost=LOST)
    chosen = scans[:: max(1, len(scans) // SAMPLES)]
    inputs = [task.as_input(one) for one in chosen]
    plan = Plan(
        name="segment-scan",
        architecture=f"SalsaNext x {width:g}",
        task=task,
        shape=(5, *SIZE),
        outputs=network.output_names,
        meaning=meaning_of_scans(
            "Classes of the taxonomy in LiDAR scans, trained on simulation alone", order
        ),
        samples=calibration(inputs),
        data=f"{order.data.name}: {len(scans):,} scans, normalized as {sensor}",
        rate=RATE,
        finish=lambda trained: balance(trained, inputs, [one.classes for one in chosen]),
    )
    return carry_out(plan, order, console)


def read_scans(flight: Path, elevation_rad: tuple[float, float]) -> list[LabeledScan]:
    """The scans of a flight as range images with the class of each cell. Raises DataError."""
    image = RangeImage(SIZE, elevation_rad, MAX_RANGE_M)
    nothing, one = (as_input(np.full(5, value, dtype=np.float32)) for value in (0, 1))
    found = []
    for scan, truth in with_truth(flight, Scan, Labels):
        nearest = image.places(scan)[0]
        classes = np.where(nearest >= 0, truth.classes.ravel()[nearest], 0)
        found.append(LabeledScan(image.channels(scan, nothing, one), classes.astype(np.uint8)))
    return found
