"""Pictures of the paper's figures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from stages.taxonomy import load_taxonomy
from tools.tables.figures import draw_views
from tools.train.aggregated import AggregatedCloud

ROAD, VEHICLE = 3, 13


def test_a_street_from_above_and_what_moves_in_wider_windows(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    road = random.uniform([-30, -20, 0], [30, 20, 0.01], (20_000, 3))
    cars = [random.uniform([k, 13, 0.5], [k + 2, 15, 1.5], (400, 3)) for k in range(-10, 11)]
    scans = np.concatenate([np.zeros(len(road)), np.repeat(np.arange(21), 400)])
    cloud = AggregatedCloud(
        points=np.concatenate([road, *cars]).astype(np.float32),
        remission=np.full(len(scans), 0.5, np.float32),
        classes=np.where(np.arange(len(scans)) < len(road), ROAD, VEHICLE).astype(np.uint8),
        scans=scans.astype(np.int32),
        path=np.column_stack([np.arange(-10, 11), np.zeros(21), np.full(21, 1.7)]),
    )
    names = [path.name for path in draw_views(cloud, tmp_path)]
    assert names == ["figure-5-cloud.png", "figure-5-scan.png", "figure-6.png"]
    picture = cv2.imread(str(tmp_path / "figure-6.png"))[..., ::-1]
    # Below the range image stands a panel for each window; the last has its legend underneath.
    purple = (picture == load_taxonomy().colors[VEHICLE]).all(axis=2)[:624]
    panels = [np.count_nonzero(purple[16 + 152 * k : 16 + 152 * (k + 1)]) for k in range(1, 4)]
    assert 0 < panels[0] < panels[1] < panels[2]
