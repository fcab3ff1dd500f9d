"""A picture of a confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.render import INK, PAPER

CELL, MARGIN = 48, 16  #: pixels
FONT = cv2.FONT_HERSHEY_SIMPLEX
TEXT = 0.42


def draw_confusion(matrix: NDArray[np.int64], names: Sequence[str]) -> NDArray[np.uint8]:
    """RGB picture of `matrix` (k, k), rows by truth and columns by prediction.

    A cell says which percentage of the row's points were predicted so, and is the bluer the more.
    Row 0 (no truth) is left out, and so are classes that neither are nor were predicted.
    """
    judged = matrix[1:]
    columns = [k for k in range(len(names)) if judged[:, k].any() or (k and matrix[k].any())]
    rows = [k for k in columns if k and matrix[k].any()]
    widest = max((cv2.getTextSize(name, FONT, TEXT, 1)[0][0] for name in names), default=0)
    left, top = MARGIN + widest + 10, MARGIN + widest + 10
    height = top + CELL * len(rows) + MARGIN + 24
    width = max(left + CELL * len(columns) + MARGIN, 320)
    canvas = np.full((height, width, 3), PAPER, dtype=np.uint8)
    for place, k in enumerate(columns):
        _write_upward(
            canvas, names[k] if k else "nothing", left + CELL * place + CELL // 2, top - 8
        )
    for line, k in enumerate(rows):
        y = top + CELL * line
        size = cv2.getTextSize(names[k], FONT, TEXT, 1)[0]
        _write(canvas, names[k], left - 8 - size[0], y + CELL // 2 + 5, INK)
        share = matrix[k, columns] / matrix[k].sum()
        for place, part in enumerate(share):
            x = left + CELL * place
            fill = [round(PAPER + (end - PAPER) * float(part)) for end in (16, 64, 144)]
            cv2.rectangle(canvas, (x + 1, y + 1), (x + CELL - 2, y + CELL - 2), fill, cv2.FILLED)
            if part >= 0.0005:
                text = f"{100 * part:.1f}" if part < 0.9995 else "100"
                wide = cv2.getTextSize(text, FONT, TEXT, 1)[0][0]
                ink = (255, 255, 255) if part > 0.5 else INK
                _write(canvas, text, x + (CELL - wide) // 2, y + CELL // 2 + 5, ink)
    _write(canvas, "rows: truth, columns: predicted, % of the row", MARGIN, height - 12, INK)
    return canvas


def _write(canvas: NDArray[np.uint8], text: str, x: int, y: int, ink: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, (x, y), FONT, TEXT, ink, 1, cv2.LINE_AA)


def _write_upward(canvas: NDArray[np.uint8], text: str, x: int, bottom: int) -> None:
    """Write text that reads upward, centered on column `x`."""
    (wide, tall), drop = cv2.getTextSize(text, FONT, TEXT, 1)
    strip = np.full((tall + drop + 2, wide + 2, 3), PAPER, dtype=np.uint8)
    _write(strip, text, 1, tall + 1, INK)
    turned = np.rot90(strip)
    start = x - turned.shape[1] // 2
    canvas[bottom - turned.shape[0] : bottom, start : start + turned.shape[1]] = turned
