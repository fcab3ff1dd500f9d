"""Pictures for people: class colors over an image, boxes, points, and the map from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PAPER = 250  #: gray of a picture's empty ground: the class colors are dark
INK = (40, 40, 40)


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """The bytes of a PNG file of an RGB (height, width, 3) or gray (height, width) image."""
    ordered = image if image.ndim == 2 else image[..., ::-1]
    sound, data = cv2.imencode(".png", np.ascontiguousarray(ordered))
    if not sound:
        raise ValueError(f"cannot write an image of shape {image.shape} as PNG")
    return bytes(data)


def blend_classes(
    image: NDArray[np.uint8], labels: NDArray[np.uint8], colors: NDArray[np.uint8], share: float
) -> NDArray[np.uint8]:
    """RGB image (height, width, 3) with `share` of the color of each pixel's class laid over it.

    `labels` (height, width), `colors` (classes, 3); class 0 leaves the image as it is.
    """
    mixed = cv2.addWeighted(image, 1.0 - share, colors[labels], share, 0.0)
    return np.where(labels[..., None] > 0, mixed, image)


def draw_points(
    image: NDArray[np.uint8], pixel: NDArray[np.float32], colors: NDArray[np.uint8], radius: int
) -> None:
    """Paint points u v (n, 2) in their colors (n, 3) into an RGB image, in place; later ones on
    top."""
    height, width = image.shape[:2]
    center = np.rint(pixel).astype(np.int64)
    for dv in range(-radius, radius + 1):
        for du in range(-radius, radius + 1):
            u, v = center[:, 0] + du, center[:, 1] + dv
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            image[v[inside], u[inside]] = colors[inside]


def draw_box(
    image: NDArray[np.uint8], box: NDArray[np.float32], text: str, color: Sequence[int]
) -> None:
    """Draw a box x0 y0 x1 y1 with its text on a plate into an RGB image, in place."""
    x0, y0, x1, y1 = (int(edge) for edge in np.rint(box))
    line = max(1, round(image.shape[1] / 600))
    paint = tuple(int(channel) for channel in color)
    cv2.rectangle(image, (x0, y0), (x1, y1), paint, line)
    size = max(0.35, image.shape[1] / 2200)
    (width, height), drop = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, line)
    top = max(y0, height + drop)
    cv2.rectangle(image, (x0, top - height - drop), (x0 + width, top), paint, cv2.FILLED)
    light = sum(paint) < 384
    ink = (255, 255, 255) if light else (0, 0, 0)
    place = (x0, top - drop // 2)
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, ink, line, cv2.LINE_AA)


def top_view(
    positions: NDArray[np.float32],
    labels: NDArray[np.uint8],
    colors: NDArray[np.uint8],
    cell_m: float,
    cell_pixels: int,
) -> NDArray[np.uint8]:
    """The highest point of each cell of the ground, in its class color: RGB, x right, y up.

    `positions` (n, 3) m with z up, `labels` (n,), `colors` (classes, 3); a cell of `cell_m`
    becomes a square of `cell_pixels`.
    """
    if len(positions) == 0:
        return np.full((cell_pixels, cell_pixels, 3), PAPER, dtype=np.uint8)
    cells = np.floor(positions[:, :2].astype(np.float64) / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    columns, rows = cells.max(axis=0) + 1
    order = np.argsort(positions[:, 2], kind="stable")  # the last write to a cell stays
    picture = np.full((rows, columns, 3), PAPER, dtype=np.uint8)
    picture[rows - 1 - cells[order, 1], cells[order, 0]] = colors[labels[order]]
    return picture.repeat(cell_pixels, axis=0).repeat(cell_pixels, axis=1)


def oblique_view(
    indices: NDArray[np.int32],
    labels: NDArray[np.uint8],
    colors: NDArray[np.uint8],
    elevation_deg: float = 50.0,
    frame: NDArray[np.int32] | None = None,
) -> NDArray[np.uint8]:
    """Voxels as cubes in parallel projection, seen from x and y low, `elevation_deg` above: RGB.

    `indices` (n, 3) with z up, `labels` (n,), `colors` (classes, 3). A cube's ground plan is a
    diamond 4 pixels wide; its top is lightest, its right side darkest. Pictures of the same
    `frame` (k, 3) show the same part of the world; without one all voxels are shown.
    """
    frame = indices if frame is None else frame
    if len(frame) == 0:
        return np.full((1, 1, 3), PAPER, dtype=np.uint8)
    x, y, z = (indices - frame.min(axis=0)).T.astype(np.float64)
    elevation = math.radians(elevation_deg)
    deep, up = 2.0 * math.sin(elevation), math.sqrt(8.0) * math.cos(elevation)  # pixels per edge

    def pixels(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> NDArray[np.int64]:
        places = np.stack([2.0 * (x - y), -deep * (x + y) - up * z])
        return np.asarray(np.rint(places), dtype=np.int64)

    column, row = pixels(x, y, z)
    top, side = math.ceil(2 * deep), math.ceil(up)
    v, u = (offset.ravel() for offset in np.mgrid[: top + side, :4])
    shade = np.where(v < top, 1.0, np.where(u < 2, 0.82, 0.64))
    shown = pixels(*(frame - frame.min(axis=0)).T.astype(np.float64))
    left, first = shown.min(axis=1)
    right, last = shown.max(axis=1)
    picture = np.full((last - first + top + side, right - left + 4, 3), PAPER, dtype=np.uint8)
    inside = (column >= left) & (column <= right) & (row >= first) & (row <= last)
    far_first = np.lexsort((z, -(x + y)))  # the last write to a pixel stays
    far_first = far_first[inside[far_first]]
    faces = (colors[:, None, :] * shade[:, None]).astype(np.uint8)  # (classes, pixels, 3)
    at = row[far_first, None] - first + v, column[far_first, None] - left + u
    picture[at] = faces[labels[far_first]]
    return picture


def add_legend(
    picture: NDArray[np.uint8],
    entries: Sequence[tuple[str, Sequence[int]]],
    pixels_per_m: float | None = None,
) -> NDArray[np.uint8]:
    """The RGB picture on a margin, a legend of (name, color) below it, and a scale bar where the
    picture has a scale."""
    margin, line, font = 16, 26, cv2.FONT_HERSHEY_SIMPLEX
    width = max(picture.shape[1], 480)
    swatch_width = [40 + cv2.getTextSize(name, font, 0.5, 1)[0][0] + 16 for name, _ in entries]
    places: list[tuple[int, int]] = []
    x, row = 0, 0 if pixels_per_m is None else 1
    for wide in swatch_width:
        if x + wide > width and x > 0:
            x, row = 0, row + 1
        places.append((x, row))
        x += wide
    height = picture.shape[0] + (row + 1) * line + margin
    canvas = np.full((height + 2 * margin, width + 2 * margin, 3), PAPER, dtype=np.uint8)
    canvas[margin : margin + picture.shape[0], margin : margin + picture.shape[1]] = picture
    base = margin + picture.shape[0] + margin
    if pixels_per_m is not None:
        meters = next((m for m in (100, 50, 20, 10, 5, 2) if m * pixels_per_m <= width / 3), 1)
        end = margin + round(meters * pixels_per_m)
        cv2.rectangle(canvas, (margin, base + 6), (end, base + 10), INK, cv2.FILLED)
        text = f"{meters} m"
        cv2.putText(canvas, text, (end + 8, base + 13), font, 0.5, INK, 1, cv2.LINE_AA)
    for (name, color), (x, row) in zip(entries, places, strict=True):
        left, top = margin + x, base + row * line
        paint = tuple(int(channel) for channel in color)
        cv2.rectangle(canvas, (left, top), (left + 28, top + 16), paint, cv2.FILLED)
        cv2.putText(canvas, name, (left + 36, top + 13), font, 0.5, INK, 1, cv2.LINE_AA)
    return canvas
