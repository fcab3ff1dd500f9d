"""From points to pixels and back: the pinhole camera with radial-tangential distortion.

The integer pixel is the pixel's center. `intrinsics` is (9,) float64: fx fy cx cy k1 k2 p1 p2 k3.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled

#: Points nearer to the camera plane than this are behind the lens or on it.
MIN_DEPTH_M = 0.1

#: A point hides what lies farther behind it than this share of its distance and this length: a
#: surface seen at a slant does not hide itself.
HIDES_SHARE = 0.1
HIDES_M = 0.5


def fold_limit(intrinsics: NDArray[np.float64]) -> float:
    """The greatest r^2 = x^2 + y^2 (at depth 1) up to which the distortion is one-to-one.

    Beyond it the polynomial r (1 + k1 r^2 + k2 r^4 + k3 r^6) falls again and would fold points from
    far outside the field of view back into the image. Infinite without distortion.
    """
    return _fold_limit(float(intrinsics[4]), float(intrinsics[5]), float(intrinsics[8]))


@lru_cache(maxsize=64)  # every image asks, of a few cameras: 0.1 ms each time
def _fold_limit(k1: float, k2: float, k3: float) -> float:
    slope = np.array([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])  # d(r d)/dr in r^2
    roots = np.roots(slope)
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(real.min()) if real.size else float("inf")


@compiled
def project(
    points: NDArray[np.float32],
    usable: NDArray[np.bool_],
    camera_from_sensor: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    width: int,
    height: int,
    limit: float,
) -> Any:
    """The points that the camera sees, and where.

    `points` (n, 3) m in the sensor's frame, `usable` (n,) the ones to look at, `camera_from_sensor`
    (4, 4), `limit` from `fold_limit`. With x = X/Z, y = Y/Z, r2 = x^2 + y^2 and d = 1 + k1 r2 +
    k2 r2^2 + k3 r2^3: u = fx (x d + 2 p1 x y + p2 (r2 + 2 x^2)) + cx and v = fy (y d + p1 (r2 +
    2 y^2) + 2 p2 x y) + cy. Seen are points with Z > `MIN_DEPTH_M`, r2 < limit and
    0 <= u <= width - 1, 0 <= v <= height - 1.

    Returns, in the order of the points: index (m,) int64, pixel u v (m, 2) float32, range in the
    camera's frame (m,) float32, m.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    t = camera_from_sensor
    index = np.empty(len(points), dtype=np.int64)
    pixel = np.empty((len(points), 2), dtype=np.float32)
    distance = np.empty(len(points), dtype=np.float32)
    seen = 0
    for i in range(len(points)):
        if not usable[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = t[2, 0] * px + t[2, 1] * py + t[2, 2] * pz + t[2, 3]
        if not z > MIN_DEPTH_M:
            continue
        metric_x = t[0, 0] * px + t[0, 1] * py + t[0, 2] * pz + t[0, 3]
        metric_y = t[1, 0] * px + t[1, 1] * py + t[1, 2] * pz + t[1, 3]
        x, y = metric_x / z, metric_y / z
        r2 = x * x + y * y
        if not r2 < limit:
            continue
        d = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = fx * (x * d + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx
        v = fy * (y * d + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy
        if u >= 0.0 and u <= width - 1 and v >= 0.0 and v <= height - 1:
            index[seen] = i
            pixel[seen, 0] = u
            pixel[seen, 1] = v
            distance[seen] = np.sqrt(metric_x * metric_x + metric_y * metric_y + z * z)
            seen += 1
    return index[:seen].copy(), pixel[:seen].copy(), distance[:seen].copy()


def hidden(
    pixel: NDArray[np.float32],
    distance: NDArray[np.float32],
    size: tuple[int, int],
    reach_px: int,
) -> NDArray[np.bool_]:
    """(m,) the point lies behind a nearer one, so that the camera does not see it.

    Of points at `pixel` (m, 2) u v and `distance` (m,) m in an image of `size` (width, height): one
    is hidden when a point at most `reach_px` beside or above it is nearer by more than
    `HIDES_SHARE` and `HIDES_M`. What hides a point rises above it in the image, so nothing is
    looked for below: there the ground itself is nearer, and a window to all sides took a fifth of
    a street for hidden, the far road first.
    """
    column, row = np.rint(pixel).astype(np.int64).T
    nearest = np.full((size[1], size[0]), np.inf, dtype=np.float32)
    np.minimum.at(nearest, (row, column), distance)
    window = np.ones((reach_px + 1, 2 * reach_px + 1), dtype=np.uint8)
    least = np.asarray(cv2.erode(nearest, window, anchor=(reach_px, reach_px)))[row, column]
    return np.asarray(distance > least * (1 + HIDES_SHARE) + HIDES_M)


def unproject(
    pixel: NDArray[np.float64], depth_m: NDArray[np.float64], intrinsics: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 3) in the camera's frame of pixels u v (n, 2) at depth Z (n,).

    The distortion is undone by Newton's method on its two equations, from the distorted point.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    target_x, target_y = (pixel[:, 0] - cx) / fx, (pixel[:, 1] - cy) / fy
    x, y = target_x.copy(), target_y.copy()
    for _ in range(20):
        r2 = x * x + y * y
        d = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))  # dd/dx = slope x
        error_x = x * d + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - target_x
        error_y = y * d + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - target_y
        j11 = d + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        j12 = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        j22 = d + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        determinant = j11 * j22 - j12 * j12
        x = x - (j22 * error_x - j12 * error_y) / determinant
        y = y - (j11 * error_y - j12 * error_x) / determinant
    return np.stack([x * depth_m, y * depth_m, depth_m], axis=1)
