"""Folders of labeled scans in public layouts, a few points each."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def sequence(folder: Path, scans: int = 3, seed: int = 0) -> Path:
    """A sequence in SemanticKITTI's layout: a road (40), a car (10) and unlabeled points."""
    random = np.random.default_rng(seed)
    (folder / "velodyne").mkdir(parents=True)
    (folder / "labels").mkdir()
    for number in range(scans):
        road = random.uniform([-20, -20, -1.8], [20, 20, -1.7], (1500, 3))
        car = random.uniform([6, 2, -1.7], [9, 4, -0.4], (300, 3))
        other = random.uniform([-9, -9, 0], [-6, -6, 0.2], (50, 3))
        rows = np.zeros((1850, 4), "<f4")
        rows[:, :3] = np.concatenate([road, car, other])
        rows[:, 3] = np.repeat([0.2, 0.8, 0.5], [1500, 300, 50])
        labels = np.repeat([40, 10 | (7 << 16), 0], [1500, 300, 50]).astype("<u4")
        rows.tofile(folder / f"velodyne/{number:06d}.bin")
        labels.tofile(folder / f"labels/{number:06d}.label")
    return folder
