"""Where the pixels of a depth camera's image lie in its next image, or in another camera's."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.projection import MIN_DEPTH_M, unproject

#: How far the depth of a warped pixel may lie from the depth measured there, relative to it.
SAME_SURFACE = np.float32(0.1)


def viewing_rays(width: int, height: int, intrinsics: NDArray[np.float64]) -> NDArray[np.float32]:
    """X/Z and Y/Z of each pixel's ray, distortion undone: (2, height, width); NaN has no ray."""
    fx, fy, cx, cy = intrinsics[:4]
    v, u = np.mgrid[:height, :width].astype(np.float64)
    if not intrinsics[4:].any():
        return np.stack([(u - cx) / fx, (v - cy) / fy]).astype(np.float32)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    with np.errstate(all="ignore"):  # far outside the calibrated cone the iteration diverges
        rays = unproject(pixel, np.ones(len(pixel)), intrinsics)[:, :2]
    return np.ascontiguousarray(rays.T, dtype=np.float32).reshape(2, height, width)


@compiled
def to_meters(depth: NDArray[Any], unit_m: float, nearest_m: float, farthest_m: float) -> Any:
    """Depth counts (height, width) as float32 m, and how many pixels have one.

    0 stands for none, and for one that is out of the sensor's reach.
    """
    meters = np.empty(depth.shape, dtype=np.float32)
    unit, nearest, farthest = np.float32(unit_m), np.float32(nearest_m), np.float32(farthest_m)
    count = 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = np.float32(depth[v, u]) * unit
            valid = z >= nearest and z <= farthest and z > np.float32(0.0)
            meters[v, u] = z if valid else np.float32(0.0)
            count += int(valid)
    return meters, count


@compiled
def row_pixels(
    depth: NDArray[np.float32],
    rays: NDArray[np.float32],
    row: int,
    first: int,
    to_from: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    limit: float,
    u: NDArray[np.float32],
    v: NDArray[np.float32],
    z: NDArray[np.float32],
) -> None:
    """Where another camera sees a stretch of an image row: pixel `u`, `v` and depth `z` (n,) m.

    The pixels from column `first` of `row` lie at their `depth` (height, width; m) along their
    `rays`; `to_from` (4, 4) takes them into the frame of the camera with `intrinsics`; `limit` is
    `projection.fold_limit`'s and the distortion that of `projection.project`. `z` is 0 where there
    is no depth or the camera cannot see the point.
    """
    t = to_from.astype(np.float32)
    t00, t01, t02, t03 = t[0, 0], t[0, 1], t[0, 2], t[0, 3]
    t10, t11, t12, t13 = t[1, 0], t[1, 1], t[1, 2], t[1, 3]
    t20, t21, t22, t23 = t[2, 0], t[2, 1], t[2, 2], t[2, 3]
    i = intrinsics.astype(np.float32)
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = i[0], i[1], i[2], i[3], i[4], i[5], i[6], i[7], i[8]
    cone, one, two = np.float32(limit), np.float32(1.0), np.float32(2.0)
    closest = np.float32(MIN_DEPTH_M)
    end = first + len(u)
    along, ray_x, ray_y = depth[row, first:end], rays[0, row, first:end], rays[1, row, first:end]
    for n in range(len(u)):  # no branches: the loop becomes vector instructions
        d = along[n]
        x, y = ray_x[n] * d, ray_y[n] * d
        far = t20 * x + t21 * y + t22 * d + t23
        ahead = (far > closest) & (d > np.float32(0.0))
        a = (t00 * x + t01 * y + t02 * d + t03) / far
        b = (t10 * x + t11 * y + t12 * d + t13) / far
        r2 = a * a + b * b
        radial = one + r2 * (k1 + r2 * (k2 + r2 * k3))
        u[n] = fx * (a * radial + two * p1 * a * b + p2 * (r2 + two * a * a)) + cx
        v[n] = fy * (b * radial + p1 * (r2 + two * b * b) + two * p2 * a * b) + cy
        z[n] = far if ahead & (r2 < cone) else np.float32(0.0)


@compiled
def warp(
    depth_before: NDArray[np.float32],
    depth_now: NDArray[np.float32],
    rays: NDArray[np.float32],
    now_from_before: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    limit: float,
) -> Any:
    """For each pixel of the image now, the pixel of the image before that shows the same surface.

    Every pixel before with a depth (height, width; m, 0 = none) is moved along its ray (`rays` of
    `viewing_rays`) and splatted to the nearest pixel now; of several the nearest in depth stays,
    of equally near ones the first. It counts where there is a depth now and both agree within
    `SAME_SURFACE`, else a foreground object would smear over what it uncovers.

    Returns source (height, width) int32, row * width + column in the image before or -1, and the
    number of pixels that have one.
    """
    height, width = depth_now.shape
    source = np.full((height, width), -1, dtype=np.int32)
    nearest = np.full((height, width), np.inf, dtype=np.float32)
    u, v = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    z, to = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.int32)
    from_pixel, depth = source.reshape(-1), nearest.reshape(-1)
    right, bottom = np.float32(width - 0.5), np.float32(height - 0.5)
    half, none = np.float32(0.5), np.float32(0.0)
    for row in range(height):
        row_pixels(depth_before, rays, row, 0, now_from_before, intrinsics, limit, u, v, z)
        for column in range(width):  # vectors, which leaves little to the loop that splats
            x, y = u[column], v[column]
            inside = (x >= -half) & (x < right) & (y >= -half) & (y < bottom) & (z[column] > none)
            x, y = x if inside else none, y if inside else none
            pixel = np.int32(y + half) * np.int32(width) + np.int32(x + half)
            to[column] = pixel if inside else np.int32(-1)
        for column in range(width):
            place = np.uint64(to[column])
            if to[column] >= 0 and z[column] < depth[place]:
                depth[place] = z[column]
                from_pixel[place] = row * width + column
    count = 0
    for row in range(height):
        for column in range(width):
            here = depth_now[row, column]
            same = (here > none) & (abs(nearest[row, column] - here) < SAME_SURFACE * here)
            source[row, column] = source[row, column] if same else np.int32(-1)
            count += int(same)
    return source, count
