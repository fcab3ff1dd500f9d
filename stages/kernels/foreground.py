"""Which points of a detection's box are the object in front (eq 5), and what a detection does to
the points of its box (eq 4).

In the order of use: `seed` and `reach_m` from the box's points, `cluster` or `cluster_organized`
from there, and once all boxes have their members, `apply_claims`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.probability import add_detection

#: Neighbors may lie this many times further apart than two beams one above the other (the paper's).
SPREAD = 1.5


@compiled
def points_in_box(pixel: NDArray[np.float32], box: NDArray[np.float32]) -> Any:
    """Rows (j,) int64 of `pixel` (m, 2) u v inside the box x0 y0 x1 y1, pixels, edges included."""
    rows = np.empty(len(pixel), dtype=np.int64)
    count = 0
    for i in range(len(pixel)):
        u, v = pixel[i, 0], pixel[i, 1]
        if u >= box[0] and u <= box[2] and v >= box[1] and v <= box[3]:
            rows[count] = i
            count += 1
    return rows[:count].copy()


def seed(distance: NDArray[np.float32]) -> int:
    """The row of the point at the 25 % quantile of `distance` (j,) m, by nearest rank.

    So it is a real point; of equal distances the first. What is not finite does not count; -1 where
    nothing counts.
    """
    finite = np.where(np.isfinite(distance), distance, np.float32(np.inf))
    count = int(np.count_nonzero(finite < np.inf))
    if count == 0:
        return -1
    rank = (count - 1) // 4
    return int(np.argmax(finite == np.partition(finite, rank)[rank]))


def reach_m(distance_m: float, vertical_pitch_rad: float, spread: float = SPREAD) -> float:
    """tau of eq 5: how far apart neighbors of an object at `distance_m` may lie.

    `vertical_pitch_rad` is the vertical field of view over the scan's rows: (pi / 2) / 128 for an
    OS0-128, twice that when every second row is used.
    """
    return spread * distance_m * vertical_pitch_rad


def near_depth(distance: NDArray[np.float32], seed_m: float, depth_m: float) -> NDArray[np.bool_]:
    """The older method, for comparison: (j,) bool, within `depth_m` of the seed's distance."""
    return np.asarray(np.abs(distance - np.float32(seed_m)) <= depth_m)


@compiled
def cluster(points: NDArray[np.float32], rows: NDArray[np.int64], first: int, tau: float) -> Any:
    """Eq 5: all points that a chain of steps of at most `tau` m joins to point `rows[first]`.

    `points` (n, 3) m, `rows` (j,) those in the box. Returns (j,) bool. Points that are not finite
    join nothing. Exactly the cluster that a KD-tree gives, by a hash of cubes of edge tau: a
    point's neighbors are in the 27 cubes around its own, which are looked up once per cube; a point
    that joined is taken out, so nobody looks at it again.
    """
    count = len(rows)
    member = np.zeros(count, dtype=np.bool_)
    if count == 0:
        return member
    member[first] = True
    x0, y0, z0 = points[rows[first], 0], points[rows[first], 1], points[rows[first], 2]
    if not (tau > 0.0 and np.isfinite(x0 + y0 + z0)):
        return member
    size = 16
    while size < 2 * count:
        size *= 2
    mask = np.uint64(size - 1)
    cube_at = np.full(size, -1, dtype=np.int32)  # hash place -> cube
    cubes = np.empty((count, 3), dtype=np.int64)
    head = np.empty(count, dtype=np.int32)  # cube -> its first point
    after = np.empty(count, dtype=np.int32)  # point -> the next of its cube
    cube_of = np.full(count, -1, dtype=np.int32)
    found = 0
    per_m = 1.0 / tau
    for j in range(count):
        p = points[rows[j]]
        x, y, z = (p[0] - x0) * per_m, (p[1] - y0) * per_m, (p[2] - z0) * per_m
        if not (abs(x) < 1e9 and abs(y) < 1e9 and abs(z) < 1e9):
            continue
        a, b, c = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        place = _place(a, b, c) & mask
        cube = cube_at[place]
        while cube >= 0 and not (
            cubes[cube, 0] == a and cubes[cube, 1] == b and cubes[cube, 2] == c
        ):
            place = (place + np.uint64(1)) & mask
            cube = cube_at[place]
        if cube < 0:
            cube = np.int32(found)
            found += 1
            cube_at[place] = cube
            cubes[cube, 0], cubes[cube, 1], cubes[cube, 2] = a, b, c
            head[cube] = -1
        cube_of[j] = cube
        if j != first:  # it joined already
            after[j] = head[cube]
            head[cube] = j
    around = np.empty((found, 27), dtype=np.int32)
    known = np.full(found, -1, dtype=np.int32)
    stack = np.empty(count, dtype=np.int32)
    stack[0], depth = first, 1
    square = np.float64(tau) * np.float64(tau)
    while depth > 0:
        depth -= 1
        i = stack[depth]
        cube = cube_of[i]
        if known[cube] < 0:
            known[cube] = 0
            for da in range(-1, 2):
                for db in range(-1, 2):
                    for dc in range(-1, 2):
                        a, b, c = cubes[cube, 0] + da, cubes[cube, 1] + db, cubes[cube, 2] + dc
                        place = _place(a, b, c) & mask
                        other = cube_at[place]
                        while other >= 0 and not (
                            cubes[other, 0] == a and cubes[other, 1] == b and cubes[other, 2] == c
                        ):
                            place = (place + np.uint64(1)) & mask
                            other = cube_at[place]
                        if other >= 0:
                            around[cube, known[cube]] = other
                            known[cube] += 1
        p = points[rows[i]]
        for number in range(known[cube]):
            other = around[cube, number]
            previous, j = np.int32(-1), head[other]
            while j >= 0:
                following = after[j]
                if _square(p, points[rows[j]]) <= square:
                    member[j] = True
                    stack[depth] = j
                    depth += 1
                    if previous < 0:
                        head[other] = following
                    else:
                        after[previous] = following
                else:
                    previous = j
                j = following
    return member


@compiled
def cluster_organized(
    points: NDArray[np.float32],
    rows: NDArray[np.int64],
    first: int,
    tau: float,
    scan_rows: int,
    scan_columns: int,
    vertical_pitch_rad: float,
) -> Any:
    """The same by a flood fill over an organized scan, `points` (scan_rows * scan_columns, 3).

    From a member at range r a point within tau lies within a = asin(tau / r) in elevation and
    asin(sin a / cos elevation) in azimuth: that window of rows and columns, one cell wider for
    beams that are not quite evenly spread, is searched. Exact as long as no beam is further than
    half a cell from its place. Columns go around.
    """
    count = len(rows)
    member = np.zeros(count, dtype=np.bool_)
    if count == 0:
        return member
    member[first] = True
    if not tau > 0.0:
        return member
    lowest, highest = rows.min() // scan_columns, rows.max() // scan_columns
    tall = highest - lowest + 1
    row_of = np.full(tall * scan_columns, -1, dtype=np.int32)  # cell -> the box's point still free
    origin = lowest * scan_columns
    for j in range(count):
        row_of[rows[j] - origin] = j
    row_of[rows[first] - origin] = -1
    horizontal_pitch = 2.0 * np.pi / scan_columns
    stack = np.empty(count, dtype=np.int32)
    stack[0], depth = first, 1
    square = np.float64(tau) * np.float64(tau)
    while depth > 0:
        depth -= 1
        cell = rows[stack[depth]]
        p = points[cell]
        x, y, z = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
        flat = np.sqrt(x * x + y * y)
        r = np.sqrt(flat * flat + z * z)
        high, wide = scan_rows, scan_columns // 2
        if tau < r:
            high = int(np.arcsin(tau / r) / vertical_pitch_rad) + 2
            if tau < flat:
                wide = min(wide, int(np.arcsin(tau / flat) / horizontal_pitch) + 2)
        v0, u0 = cell // scan_columns - lowest, cell % scan_columns
        span = min(2 * wide + 1, scan_columns)
        start = u0 - wide
        start = start + scan_columns if start < 0 else start
        for v in range(max(v0 - high, 0), min(v0 + high + 1, tall)):
            u = start
            for _ in range(span):
                place = np.uint64(v * scan_columns + u)
                j = row_of[place]
                if j >= 0 and _square(p, points[place + np.uint64(origin)]) <= square:
                    row_of[place] = -1
                    member[j] = True
                    stack[depth] = j
                    depth += 1
                u += 1
                u = 0 if u == scan_columns else u
    return member


@compiled
def _place(a: Any, b: Any, c: Any) -> Any:
    """A hash of a cube's indices."""
    h = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(c) * np.uint64(0x165667B19E3779F9)
    return h ^ (h >> np.uint64(29))


@compiled
def _square(p: NDArray[np.float32], q: NDArray[np.float32]) -> Any:
    """Squared distance, in float64 so that both clusters agree on a distance of exactly tau."""
    x = np.float64(p[0]) - np.float64(q[0])
    y = np.float64(p[1]) - np.float64(q[1])
    z = np.float64(p[2]) - np.float64(q[2])
    return x * x + y * y + z * z


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """What a detection says of the points in its box."""

    index: NDArray[np.int64]  #: (j,) rows of the cloud inside the box
    pixel: NDArray[np.float32]  #: (j, 2) u v of those
    member: NDArray[np.bool_]  #: (j,) belongs to the object; the rest lies behind or before it
    box: NDArray[np.float32]  #: (4,) x0 y0 x1 y1, pixels
    label: int
    score: float  #: 0..1
    source: (
        int  #: bit of the detector in `voted`; a detector's boxes count once per point and class
    )


def apply_claims(
    claims: Sequence[Claim],
    total: NDArray[np.float32],
    voted: NDArray[np.uint32],
    prior: NDArray[np.float32],
    prior_voted: NDArray[np.uint32],
    classes: int,
) -> None:
    """Reset what the boxes prove wrong, then multiply the detections (eq 4) in, in place.

    `total` (n, 16) log scores, `voted` (n,) bits of the sources that said something of a point (0:
    unlabeled); `prior` and `prior_voted` the same before any image (what the LiDAR network said, or
    uniform and 0).

    Around an object the image's class bleeds onto what stands behind. So a point of the box that is
    not the object's, but whose likeliest class is the box's, goes back to its prior. That happens
    for all boxes before any detection is applied, and never to a point that is an object of this
    class for some box: else one box would undo another. Of one detector's boxes of one class a
    point takes the best scored: they are not independent. Detectors of different cameras are.
    """
    own = {claim.label: np.zeros(len(total), dtype=np.bool_) for claim in claims}
    for claim in claims:
        own[claim.label][claim.index[claim.member]] = True
    for claim in claims:
        outside = claim.index[~claim.member]
        _reset(total, voted, prior, prior_voted, outside, own[claim.label], claim.label, classes)
    taken: dict[tuple[int, int], NDArray[np.bool_]] = {}
    said = np.zeros(len(total), dtype=np.bool_)
    for claim in sorted(claims, key=lambda claim: -claim.score):
        done = taken.setdefault((claim.source, claim.label), np.zeros(len(total), dtype=np.bool_))
        members = np.flatnonzero(claim.member & ~done[claim.index])
        add_detection(
            total,
            said,
            claim.index,
            claim.pixel,
            members,
            claim.box,
            claim.score,
            claim.label,
            classes,
        )
        done[claim.index[members]] = True
        voted[claim.index[members]] |= np.uint32(claim.source)


@compiled
def _reset(
    total: NDArray[np.float32],
    voted: NDArray[np.uint32],
    prior: NDArray[np.float32],
    prior_voted: NDArray[np.uint32],
    outside: NDArray[np.int64],
    own: NDArray[np.bool_],
    label: int,
    classes: int,
) -> None:
    for i in outside:
        if own[i]:
            continue
        best = 0
        for k in range(1, classes):
            if total[i, k] > total[i, best]:
                best = k
        if best == label:
            total[i] = prior[i]
            voted[i] = prior_voted[i]
