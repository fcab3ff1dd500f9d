"""Detections in an image of class probabilities (eq 7): which pixels they are, and the update.

A `share` (rows, columns) float32 over a window of the image is the Gaussian of eq 4 in the box,
exp(-((u - cx)^2 / sx^2 + (v - cy)^2 / sy^2) / 2) with sx, sy half the box's width and height, and 0
outside it. Windows start at pixel (left, top). Boxes are x0 y0 x1 y1, edges included.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.image_fusion import CAP
from stages.kernels.warp import row_pixels

#: No detection is surer than this.
SUREST = 0.999


@compiled
def gaussian(u: float, v: float, box: NDArray[np.float32]) -> Any:
    """The Gaussian factor of a pixel in a box: 1 in its center, 0.607 mid-edge, 0.368 in a corner,
    0 outside."""
    if not (u >= box[0] and u <= box[2] and v >= box[1] and v <= box[3]):
        return 0.0
    a = (u - 0.5 * (box[0] + box[2])) / max(0.5 * (box[2] - box[0]), 0.5)  # at least a pixel:
    b = (v - 0.5 * (box[1] + box[3])) / max(
        0.5 * (box[3] - box[1]), 0.5
    )  # an empty box divides by 0
    return np.exp(-0.5 * (a * a + b * b))


@compiled
def share_of_box(box: NDArray[np.float32], width: int, height: int) -> Any:
    """left, top and `share` of a box in an image of this size; the share may be empty."""
    # Held on both sides: a float far outside has no integer.
    left = int(np.ceil(min(max(box[0], 0.0), width)))
    top = int(np.ceil(min(max(box[1], 0.0), height)))
    right = int(np.floor(max(min(box[2], width - 1.0), -1.0)))
    bottom = int(np.floor(max(min(box[3], height - 1.0), -1.0)))
    share = np.empty((max(bottom - top + 1, 0), max(right - left + 1, 0)), dtype=np.float32)
    middle_x, middle_y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    across = np.empty(share.shape[1], dtype=np.float32)
    for column in range(share.shape[1]):  # the Gaussian is a product of one along each axis
        across[column] = gaussian(left + column, middle_y, box)
    for row in range(share.shape[0]):
        down = np.float32(gaussian(middle_x, top + row, box))
        for column in range(share.shape[1]):
            share[row, column] = down * across[column]
    return left, top, share


@compiled
def pixels_in_other(
    depth: NDArray[np.float32],
    rays: NDArray[np.float32],
    other_from_here: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    limit: float,
) -> Any:
    """Where another camera sees each pixel: u, v (2, height, width), u NaN where it does not."""
    height, width = depth.shape
    pixels = np.empty((2, height, width), dtype=np.float32)
    z = np.empty(width, dtype=np.float32)
    for row in range(height):
        u, v = pixels[0, row], pixels[1, row]
        row_pixels(depth, rays, row, 0, other_from_here, intrinsics, limit, u, v, z)
        for column in range(width):
            u[column] = u[column] if z[column] > 0.0 else np.float32(np.nan)
    return pixels


@compiled
def share_of_other(box: NDArray[np.float32], pixels: NDArray[np.float32]) -> Any:
    """left, top and `share` of another camera's box, by `pixels` of `pixels_in_other`."""
    height, width = pixels.shape[1], pixels.shape[2]
    left, top, right, bottom = width, height, -1, -1
    x0, y0, x1, y1 = box[0], box[1], box[2], box[3]
    for row in range(height):
        u, v = pixels[0, row], pixels[1, row]
        hits = 0
        for n in range(width):
            hits += (u[n] >= x0) & (u[n] <= x1) & (v[n] >= y0) & (v[n] <= y1)
        if hits == 0:
            continue
        top, bottom = min(top, row), row
        for n in range(width):
            if u[n] >= x0 and u[n] <= x1 and v[n] >= y0 and v[n] <= y1:
                left, right = min(left, n), max(right, n)
    share = np.empty((max(bottom - top + 1, 0), max(right - left + 1, 0)), dtype=np.float32)
    for row in range(share.shape[0]):
        for column in range(share.shape[1]):
            share[row, column] = gaussian(
                pixels[0, top + row, left + column], pixels[1, top + row, left + column], box
            )
    return left, top, share


@compiled
def _grow(depth: NDArray[np.float32], share: NDArray[np.float32], growth: float) -> Any:
    """`foreground` without the gaps; the second value says whether any pixel had a depth."""
    rows, columns = share.shape
    members = np.zeros((rows, columns), dtype=np.bool_)
    known = np.empty(rows * columns, dtype=np.float32)
    count = 0
    for row in range(rows):
        for column in range(columns):
            if share[row, column] > 0.0 and depth[row, column] > 0.0:
                known[count] = depth[row, column]
                count += 1
    if count == 0:
        return members, False
    rank = (count - 1) // 4
    seed = np.partition(known[:count], rank)[rank]
    step = np.float32(growth) * seed
    start, best = -1, np.float32(0.0)
    for row in range(rows):
        for column in range(columns):
            near = abs(depth[row, column] - seed) <= step and depth[row, column] > 0.0
            if near and share[row, column] > best:
                start, best = row * columns + column, share[row, column]
    stack = np.empty(rows * columns, dtype=np.int64)
    stack[0], size = start, 1
    members[start // columns, start % columns] = True
    while size > 0:
        size -= 1
        row, column = divmod(stack[size], columns)
        here = depth[row, column]
        for side in range(4):
            r = row + (side == 0) - (side == 1)
            c = column + (side == 2) - (side == 3)
            if r < 0 or r >= rows or c < 0 or c >= columns or members[r, c]:
                continue
            there = depth[r, c]
            if there > 0.0 and share[r, c] > 0.0 and abs(there - here) < step:
                members[r, c] = True
                stack[size] = r * columns + c
                size += 1
    return members, True


@compiled
def _row_ends(members: NDArray[np.bool_]) -> Any:
    """x y (n, 1, 2) int32 of the first and last member of each row: all that a hull depends on."""
    ends = np.empty((2 * members.shape[0], 1, 2), dtype=np.int32)
    count = 0
    for row in range(members.shape[0]):
        columns = np.flatnonzero(members[row])
        if len(columns) > 0:
            ends[count, 0], ends[count + 1, 0] = (columns[0], row), (columns[-1], row)
            count += 2
    return ends[:count]


def foreground(
    depth: NDArray[np.float32], share: NDArray[np.float32], growth: float
) -> NDArray[np.bool_]:
    """The pixels of a box (rows, columns) that are the object in front.

    As in the cloud (eq 5): the seed depth is the 25 % quantile of the depths in the box, by nearest
    rank; the seed is the pixel nearest the box's center among those within tau of it (a single
    speckle at the quantile leads nowhere); from there grow all 4-neighbors that differ by less than
    tau = `growth` * seed depth. Pixels without depth within the convex hull belong to it as well.
    Where no pixel has a depth the whole box is the object. `depth` (rows, columns) m, 0 = none.
    """
    members, grown = _grow(depth, share, growth)
    inside: NDArray[np.bool_] = share > 0
    if not grown:
        return inside
    gaps = inside & (depth == 0)
    if gaps.any():
        hull = cv2.convexHull(_row_ends(members))
        filled = np.zeros(members.shape, dtype=np.uint8)
        cv2.fillConvexPoly(filled, hull, 1)
        members |= gaps & filled.view(np.bool_)
    return np.asarray(members)


@compiled
def detect(
    fused: NDArray[np.float32],
    mask: NDArray[np.uint8],
    confidence: NDArray[np.float32],
    claimed: NDArray[np.uint16],
    left: int,
    top: int,
    share: NDArray[np.float32],
    members: NDArray[np.bool_],
    score: float,
    label: int,
) -> None:
    """Multiply a detection's distribution (eq 4) into its member pixels, in place.

    s = score * share, held in [1 / C, `SUREST`], is the probability of `label`; every other class
    has (1 - s) / (C - 1). With q = P(label) and d = (C - 1) s / (1 - s), eq 7 becomes P(label) =
    q d / (1 + q (d - 1)) and every other class is divided by 1 + q (d - 1). The result is capped as
    in `image_fusion`. Arrays are those of `fuse_rows`; `claimed` (height, width) holds a bit per
    class: a pixel takes only the first box of a class, so the strongest must come first.
    """
    classes = fused.shape[1]
    rows, columns = share.shape
    even = CAP / np.float32(max(classes - 1, 1))
    kept = np.float32(1.0) - even * np.float32(classes)
    bit = np.uint16(1 << label)
    times, odds = np.empty(columns, dtype=np.float32), np.empty(columns, dtype=np.float32)
    plus = np.empty(columns, dtype=np.float32)
    for row in range(rows):
        line = fused[top + row]
        for column in range(columns):
            times[column], odds[column], plus[column] = 1.0, 1.0, 0.0
            s = min(score * share[row, column], SUREST)
            taken = claimed[top + row, left + column] & bit
            if not members[row, column] or taken or not s * classes > 1.0:
                continue
            claimed[top + row, left + column] |= bit
            d = (classes - 1) * s / (1.0 - s)
            q = line[label, left + column]
            times[column] = kept / (1.0 + q * (d - 1.0))
            odds[column], plus[column] = d, even
        for k in range(classes):
            part = line[k, left : left + columns]
            for column in range(columns):
                gain = times[column] * odds[column] if k == label else times[column]
                part[column] = part[column] * gain + plus[column]
        for column in range(columns):
            old, at = mask[top + row, left + column], left + column
            here = line[label, at]
            if here > line[old, at] or (here == line[old, at] and label < old):
                mask[top + row, at] = label
            confidence[top + row, at] = line[mask[top + row, at], at]
