"""The curve of a training: a CSV that grows as it goes on, and its picture."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

#: Size of the picture, width and height, and the margin around the curve.
SIZE_PX, MARGIN_PX = (960, 480), 56
COLORS_BGR = ((40, 40, 40), (180, 90, 20), (30, 110, 220), (60, 150, 60))


class Curve:
    """The mean of each part of the loss over the steps since the last row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rate = 0.0
        self._step = 0
        self._parts: list[Mapping[str, float]] = []
        self.lately = float("nan")  #: the loss, averaged over some 20 steps

    def add(self, step: int, rate: float, parts: Mapping[str, float]) -> None:
        """One step's parts of the loss."""
        self._step, self._rate = step, rate
        self._parts.append(dict(parts))
        total = sum(parts.values())
        self.lately = total if np.isnan(self.lately) else 0.95 * self.lately + 0.05 * total

    def write_row(self, seconds: float) -> None:
        """Append a row and begin the next."""
        means = {name: float(np.mean([p[name] for p in self._parts])) for name in self._parts[0]}
        row = {"step": self._step, "seconds": f"{seconds:.1f}", "rate": f"{self._rate:.6f}"}
        row |= {"loss": f"{sum(means.values()):.4f}"}
        row |= {name: f"{mean:.4f}" for name, mean in means.items()}
        new = not self.path.is_file()
        with self.path.open("a", newline="") as file:
            writer = csv.DictWriter(file, row)
            if new:
                writer.writeheader()
            writer.writerow(row)
        self._parts = []

    def cut(self, step: int) -> None:
        """Forget the rows after a step: they were not saved with it and come again."""
        if not self.path.is_file():
            return
        header, *rows = self.path.read_text().splitlines()
        kept = [row for row in rows if int(row.partition(",")[0]) <= step]
        self.path.write_text("\n".join([header, *kept]) + "\n")
        if kept:
            self.lately = float(kept[-1].split(",")[header.split(",").index("loss")])

    def draw(self, png: Path) -> None:
        """The picture of the curve, the loss on a logarithmic axis."""
        if not self.path.is_file():
            return
        with self.path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        if rows:
            names = [name for name in rows[0] if name not in ("step", "seconds", "rate")]
            values = {name: np.array([float(row[name]) for row in rows]) for name in names}
            steps = np.array([int(row["step"]) for row in rows])
            cv2.imwrite(str(png), _picture(steps, values))


def _picture(
    steps: NDArray[np.int64], values: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.uint8]:
    width, height = SIZE_PX
    canvas = np.full((height, width, 3), 255, np.uint8)
    logs = {name: np.log10(np.maximum(one, 1e-4)) for name, one in values.items()}
    stacked = np.concatenate(list(logs.values()))
    low, high = np.floor(stacked.min() * 5) / 5, np.ceil(stacked.max() * 5) / 5 + 1e-9

    def place(step: float, log: float) -> tuple[int, int]:
        x = MARGIN_PX + (step / max(steps[-1], 1)) * (width - 2 * MARGIN_PX)
        y = height - MARGIN_PX - (log - low) / (high - low) * (height - 2 * MARGIN_PX)
        return round(x), round(y)

    for tick in np.linspace(low, high, 5):
        left, right = place(0, tick), place(steps[-1], tick)
        cv2.line(canvas, left, right, (225, 225, 225), 1)
        _write(canvas, f"{10**tick:.2f}", (4, left[1] + 4))
    for tick in np.linspace(0, steps[-1], 5):
        x, y = place(tick, low)
        _write(canvas, f"{tick:.0f}", (x - 16, y + 20))
    _write(canvas, "loss by step", (MARGIN_PX, 24))
    for number, (name, log) in enumerate(logs.items()):
        color = COLORS_BGR[number % len(COLORS_BGR)]
        points = np.array([place(*pair) for pair in zip(steps, log, strict=True)], np.int32)
        cv2.polylines(canvas, [points], False, color, 2, cv2.LINE_AA)
        _write(canvas, name, (width - MARGIN_PX - 60, 24 + 20 * number), color)
    return canvas


def _write(
    canvas: NDArray[np.uint8], text: str, where: tuple[int, int], color: tuple[int, ...] = (0, 0, 0)
) -> None:
    cv2.putText(canvas, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.45, color, 1, cv2.LINE_AA)
