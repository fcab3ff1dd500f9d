"""The evidence of a scan's points by row: of a network, of the cameras, of both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.geometry import has_return
from stages.kernels.probability import accumulate, bound_rows, uniform_rows
from stages.observed import Observation, Said
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, Scan
from tools.tables.scan_judging import ScanNetwork
from tools.tables.world import MIN_RANGE_M


def fused_evidence(
    observation: Observation, network: ScanNetwork | None, *, cameras: bool
) -> Cloud:
    """Log scores of all points, of the network (None: it says nothing) times those of cameras;
    nothing of the vehicle itself."""
    classes = len(load_taxonomy())
    one = observation
    if network is None:
        total = uniform_rows(len(one.points), classes)
        evidence = np.zeros(len(one.points), dtype=np.bool_)
    else:
        scan = Scan(one.points, one.remission, None, one.shape, one.sensor)
        scores, said = network.scores(scan)
        total, evidence = scores.copy(), said.copy()
        total[:, 0] = total[:, 1:classes].min(axis=1)  # background is never trained
        evidence &= bound_rows(total, classes)
    if cameras:
        rows = one.camera.rows()
        sound = bound_rows(rows, classes)
        index = one.camera.index.astype(np.int64)
        accumulate(total, evidence, index, rows, sound, classes)
    evidence &= has_return(as_input(one.points), MIN_RANGE_M)
    pose = one.map_from_sensor
    return Cloud(one.points, total, evidence, pose, one.sensor)


def classes_of(cloud: Cloud) -> NDArray[np.int64]:
    """(n,) the likeliest class but background, 0 without evidence."""
    classes = len(load_taxonomy())
    best = 1 + cloud.log_scores[:, 1:classes].argmax(axis=1)
    return np.where(cloud.evidence, best, 0).astype(np.int64)


def with_fused(observation: Observation, cloud: Cloud) -> Observation:
    """The observation with another fused evidence: for a map of that network."""
    one = observation
    return Observation(
        one.stamp, one.points, one.remission, one.shape, one.sensor, one.map_from_sensor,
        one.camera, Said.of(cloud), one.degraded,
    )  # fmt: skip
