"""Scans of a few points for the tests of the tables: what is true, what is seen, what is said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.observed import Observation, Said
from stages.types import Scan
from tools.tables.plan import RowPlan
from tools.tables.world import JudgedScan

ROAD, PERSON, VEHICLE, BUILDING = 3, 5, 13, 1


def rows(classes: list[int], sure: float = 4.0) -> NDArray[np.float32]:
    scores = np.zeros((len(classes), 16), np.float32)
    scores[np.arange(len(classes)), classes] = sure
    scores[:, 15] = -1e4
    return scores


class Network:
    """Says a class of each point, and nothing of the last one."""

    def __init__(self, classes: list[int], sure: float = 2.0) -> None:
        self._rows = rows(classes, sure)

    def scores(self, scan: Scan) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        said = np.ones(len(scan.points), np.bool_)
        said[-1] = False
        return self._rows, said


def judged(
    truth: list[int],
    visible: list[int],
    camera: dict[int, int],
    things: list[int] | None = None,
) -> JudgedScan:
    n = len(truth)
    points = np.column_stack([np.arange(n) + 2.1, np.full(n, 0.1), np.full(n, 0.1)])
    index = np.array(sorted(camera), np.int32)
    said = Said(index, rows([camera[k] for k in sorted(camera)]).astype(np.float16))
    observation = Observation(
        0, points.astype(np.float32), None, None, "lidar", np.eye(4), said, None, False
    )
    seen = np.zeros(n, np.bool_)
    seen[visible] = True
    which = np.array(things or range(1, n + 1), np.uint16)
    return JudgedScan(observation, np.array(truth, np.uint8), seen, which)


def row(**changes: object) -> RowPlan:
    return RowPlan.model_validate({"title": "t"} | changes)
