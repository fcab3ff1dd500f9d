"""The four panels of the paper's Fig 8: a scan's range image, and who labels how much of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import as_input
from stages.kernels.range_image import ranges
from stages.kernels.render import INK, PAPER, add_legend
from stages.observed import Observation
from stages.scan_image import RangeImage
from stages.taxonomy import load_taxonomy
from stages.types import Scan

#: Cells of a panel at most, and its width in pixels.
ROWS, COLUMNS, WIDTH = 64, 512, 1024
#: Of a return without a label, and of no return.
UNLABELED, EMPTY = 228, 255
#: Range that is drawn darkest, m.
FAR_M = 40.0
CAPTION = 24
MARK = (0, 90, 255)  #: of the boxes around what is marked, RGB


def range_panels(
    observation: Observation,
    labelings: Mapping[str, NDArray[np.uint8] | None],
    marked: Sequence[NDArray[np.int64]] = (),
) -> NDArray[np.uint8]:
    """RGB: the range image, and below it one panel for each labeling (n,) by its caption; None is
    drawn as the caption alone, which says why. Each of the sets of points `marked` gets a box."""
    taxonomy = load_taxonomy()
    rows, columns = observation.shape or (ROWS, COLUMNS)
    image = RangeImage((min(rows, ROWS), min(columns, COLUMNS)), elevation_of(observation))
    points = observation.points
    nearest = image.places(
        Scan(points, observation.remission, None, observation.shape, observation.sensor)
    )[0]
    distance = np.where(nearest >= 0, ranges(as_input(points))[nearest], 0)
    near = np.clip(distance / FAR_M, 0, 1) ** 0.5
    colors = cv2.applyColorMap((255 * (1 - near)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    colors[distance <= 0] = EMPTY
    boxes = [box for rows in marked if (box := _cells_around(np.isin(nearest, rows))) is not None]
    panels = [_panel("range, near is light", np.ascontiguousarray(colors[..., ::-1]), boxes)]
    seen: set[int] = set()
    for caption, labels in labelings.items():
        if labels is None:
            panels.append(_panel(caption, None))
            continue
        ids = np.where(nearest >= 0, labels[nearest], 0)
        seen |= set(np.unique(ids).tolist())
        picture = taxonomy.colors[ids]
        picture[ids == 0] = UNLABELED
        picture[distance <= 0] = EMPTY
        panels.append(_panel(caption, picture, boxes))
    shown = sorted(seen - {0})
    legend = [(taxonomy.names[k], taxonomy.colors[k].tolist()) for k in shown]
    return add_legend(np.concatenate(panels), [*legend, ("no label", (UNLABELED,) * 3)])


def elevation_of(observation: Observation) -> tuple[float, float]:
    """The lowest and the highest elevation of a scan, rad: a sensor's field of view."""
    if observation.shape is not None:
        return (-np.pi / 4, np.pi / 4)  # an OS0; few returns would tell less of its rows
    distance = ranges(as_input(observation.points))
    far = distance > 1.0
    if not far.any():
        return (-np.pi / 4, np.pi / 4)
    elevation = np.arcsin(np.clip(observation.points[far, 2] / distance[far], -1, 1))
    lowest, highest = np.quantile(elevation, [0.002, 0.998])
    return (float(lowest) - 0.005, float(highest) + 0.005)


def _cells_around(cells: NDArray[np.bool_]) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the cells (rows, columns) that are set, None where none is.

    A thing behind the sensor lies at both ends of the image: the box is around its larger part.
    """
    if not cells.any():
        return None
    half = cells.shape[1] // 2
    start, part = 0, cells
    if np.ptp(np.flatnonzero(cells.any(axis=0))) >= half:
        left, right = cells[:, :half], cells[:, half:]
        behind = np.count_nonzero(right) > np.count_nonzero(left)
        start, part = (half, right) if behind else (0, left)
    ys, xs = np.nonzero(part)
    return start + int(xs.min()), int(ys.min()), start + int(xs.max()), int(ys.max())


def _panel(
    caption: str,
    picture: NDArray[np.uint8] | None,
    boxes: Sequence[tuple[int, int, int, int]] = (),
) -> NDArray[np.uint8]:
    bar = np.full((CAPTION, WIDTH, 3), PAPER, dtype=np.uint8)
    place = (6, CAPTION - 8)
    cv2.putText(bar, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    if picture is None:
        return bar
    cell = WIDTH // picture.shape[1]
    size = (WIDTH, picture.shape[0] * cell)
    large = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    for left, top, right, bottom in boxes:
        first = (left * cell - 3, top * cell - 3)
        last = ((right + 1) * cell + 2, (bottom + 1) * cell + 2)
        cv2.rectangle(large, first, last, MARK, 1)
    return np.concatenate([bar, large])
