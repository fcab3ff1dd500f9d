"""Fuse what cameras and detectors say into the points of a LiDAR scan (eq 1-4)."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.message import Message, Span
from pipeline.stage import Stage
from stages.frames import View, look, map_from_sensor, mounted, without_hidden
from stages.kernels.compiled import as_input, locked
from stages.kernels.foreground import (
    Claim,
    apply_claims,
    cluster,
    cluster_organized,
    near_depth,
    points_in_box,
    reach_m,
    seed,
)
from stages.kernels.geometry import deskew, has_return, interpolate_poses, invert, sweep_knots
from stages.kernels.probability import accumulate, bound_rows, uniform_rows
from stages.kernels.sampling import sample_scores
from stages.taxonomy import load_taxonomy
from stages.types import (
    CHANNELS,
    Calibration,
    Camera,
    ClassScores,
    Cloud,
    Detections,
    Pose,
    Scan,
    Trajectory,
)

log = logging.getLogger(__name__)

#: What `FuseCloud.statistics` counts over all scans; a point hidden in two images counts twice.
COUNTED = (
    "points",
    "points_with_evidence",
    "points_hidden",
    "points_with_unsound_lidar_scores",
    "points_with_unsound_image_scores",
    "boxes_unsound",
    "stamps_without_pose",
    "sweeps_not_deskewed",
)


class FuseCloud(Stage):
    """Points with the product of all evidence: of the LiDAR network, of images and of boxes.

    `cloud` is a bare scan (camera evidence only) or one with class scores. A point that no camera
    sees and no box claims keeps what the LiDAR network said of it, and is unlabeled without one.

    With a `trajectory`, each camera sees the scan from where the vehicle was at the image's stamp
    (eq 1), a scan with times is moved into the sensor's frame at its stamp, and the result says
    where that frame lies in the map. Evidence at an instant that the poses do not cover is left
    out; without any pose the vehicle is taken as standing still. `statistics` counts both.
    """

    def __init__(
        self,
        *,
        calibration: Calibration,
        min_range_m: float = 1.0,
        foreground: Literal["cluster", "depth", "box"] = "cluster",
        vertical_pitch_deg: float = 90 / 128,
        foreground_m: float = 1.0,
        occlusion_deg: float = 0.0,
    ) -> None:
        """`min_range_m` leaves out the vehicle itself. `foreground`: which points of a box are the
        object: the Euclidean cluster from the 25 % quantile of their distances (eq 5), whose
        neighbors lie within 1.5 times the spacing of beams `vertical_pitch_deg` apart; those within
        `foreground_m` of that quantile; or all.

        `occlusion_deg` above 0 gives no image evidence to points that a nearer point hides, looking
        this far around each: the camera saw what hides them. Take the angle between the LiDAR's
        beams or a cell of the scores, whichever is larger. The image has to be upright.
        """
        if not 0 <= occlusion_deg < 45:
            raise ValueError(f"occlusion_deg must be at least 0 and below 45, not {occlusion_deg}")
        if not 0 < vertical_pitch_deg < 45:
            raise ValueError(
                f"vertical_pitch_deg must be above 0 and below 45, not {vertical_pitch_deg}"
            )
        for name, value in (("min_range_m", min_range_m), ("foreground_m", foreground_m)):
            if not value >= 0:
                raise ValueError(f"{name} must be at least 0, not {value}")
        self._calibration = calibration
        self._min_range_m = min_range_m
        self._foreground = foreground
        self._pitch_rad = float(np.radians(vertical_pitch_deg))
        self._foreground_m = foreground_m
        self._occlusion_deg = occlusion_deg
        self._classes = len(load_taxonomy())
        self._counts: Counter[str] = Counter()

    def open(self) -> None:
        """Compile the kernels (or load them from the cache) now, not during the first scan."""
        for camera in self._calibration.cameras()[:1]:
            point, now = np.ones((1, 3), dtype=np.float32), np.zeros(1, dtype=np.int32)
            scan = Message.at(0, Scan(point, None, now, None, camera))
            box = np.array([[0, 0, 1, 1]], dtype=np.float32)
            found = Detections(box, np.ones(1, np.int64), np.ones(1, np.float32), camera)
            poses = tuple(Message.at(stamp, Pose(np.eye(4))) for stamp in (0, 1))
            for kind in (np.float32, np.int8, np.uint8):
                grid = np.zeros((1, 2, 2, CHANNELS), dtype=kind)
                image = ClassScores(grid, box, 1.0, 0, camera, (1, 1))
                self.process(scan, (Message.at(0, image),), (Message.at(0, found),), poses)
            row, near = np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.float32)
            for shape in (None, (1, 1)):
                member = self._members(as_input(point), shape, row, near)
            pixel, votes = np.zeros((1, 2), dtype=np.float32), np.zeros(1, dtype=np.uint32)
            claim = Claim(row, pixel, member, as_input(box[0]), 1, 0.5, 1)
            total = uniform_rows(1, self._classes)
            apply_claims([claim], total, votes, total.copy(), votes.copy(), self._classes)
        self._counts.clear()

    def statistics(self) -> Mapping[str, float]:
        """Points with a return so far, those that got evidence, and what was left out and why."""
        return dict.fromkeys(COUNTED, 0) | self._counts

    def process(
        self,
        cloud: Message[Scan | Cloud],
        scores: tuple[Message[ClassScores] | None, ...] = (),
        boxes: tuple[Message[Detections] | None, ...] = (),
        trajectory: Span[Pose] = (),
    ) -> Cloud:
        path = Trajectory.of(trajectory) if trajectory else None
        sensor = cloud.payload.sensor
        map_from_lidar = self._map_from(sensor, cloud.stamp, path)
        points = as_input(self._points_at_stamp(cloud, path, map_from_lidar))
        usable = has_return(points, self._min_range_m)
        total, evidence = self._prior(cloud.payload, usable)
        voted = evidence.astype(np.uint32)

        @cache
        def view_of(camera: str, stamp: int) -> View | None:
            if path is None:
                chain = mounted(self._calibration, camera, sensor)
            else:
                map_from_camera = self._map_from(camera, stamp, path)
                if map_from_camera is None or map_from_lidar is None:
                    return None
                chain = invert(map_from_camera) @ map_from_lidar
            return self._view(self._calibration.camera(camera), points, usable, chain)

        claims: list[Claim] = []
        shape = cloud.payload.shape
        for bit, found in enumerate(boxes, start=1 + len(scores)):
            if found and (view := view_of(found.payload.camera, found.stamp)):
                claims += self._claims(points, shape, view, found.payload, 1 << bit)
        prior, prior_voted = _rows_of(claims, total), voted.copy()
        for bit, image in enumerate(scores, start=1):
            if image and (view := view_of(image.payload.camera, image.stamp)):
                said = self._add_scores(total, evidence, view, image.payload)
                voted[view.index[said]] |= np.uint32(1 << bit)
        apply_claims(claims, total, voted, prior, prior_voted, self._classes)
        evidence = voted != 0
        self._counts["points"] += int(np.count_nonzero(usable))
        self._counts["points_with_evidence"] += int(np.count_nonzero(evidence))
        return Cloud(points, total, evidence, map_from_lidar, sensor, None, shape, voted)

    def _view(
        self,
        camera: Camera,
        points: NDArray[np.float32],
        usable: NDArray[np.bool_],
        camera_from_lidar: NDArray[np.float64],
    ) -> View:
        view = look(camera, points, usable, camera_from_lidar)
        if not self._occlusion_deg:
            return view
        seen = without_hidden(view, camera, self._occlusion_deg)
        self._counts["points_hidden"] += len(view.index) - len(seen.index)
        return seen

    def _map_from(
        self, sensor: str, stamp: int, path: Trajectory | None
    ) -> NDArray[np.float64] | None:
        """The sensor's pose in the map at `stamp`; None, and counted, where no pose covers it."""
        if path is None:
            return None
        pose = map_from_sensor(self._calibration, sensor, stamp, path)
        if pose is None:
            self._leave_out("stamps_without_pose", f"no pose of {sensor} at its stamp", stamp)
        return pose

    def _points_at_stamp(
        self,
        cloud: Message[Scan | Cloud],
        path: Trajectory | None,
        map_from_lidar: NDArray[np.float64] | None,
    ) -> NDArray[np.float32]:
        """The points in the sensor's frame at the stamp: moved there where they carry times."""
        points, times_ns = cloud.payload.points, cloud.payload.times_ns
        if times_ns is None or len(points) == 0 or path is None or map_from_lidar is None:
            return points
        knots = sweep_knots(int(times_ns.min()), int(times_ns.max()))
        poses, covered = interpolate_poses(path.stamps, path.map_from_base, cloud.stamp + knots)
        if not covered.all():
            self._leave_out("sweeps_not_deskewed", "no pose over the whole sweep", cloud.stamp)
            return points
        base_from_lidar = self._calibration.sensor(cloud.payload.sensor).base_from_sensor
        motion = invert(map_from_lidar) @ poses @ base_from_lidar
        moved: NDArray[np.float32] = deskew(
            as_input(points), as_input(times_ns), int(knots[0]), int(knots[-1]), motion
        )
        return moved

    def _prior(
        self, cloud: Scan | Cloud, usable: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """What the LiDAR network said, or nothing."""
        if isinstance(cloud, Scan):
            return uniform_rows(len(cloud.points), self._classes), np.zeros_like(usable)
        if cloud.log_scores.shape != (len(cloud.points), CHANNELS):
            raise StageError(
                f"cloud of '{cloud.sensor}': log_scores of shape {cloud.log_scores.shape} for "
                f"{len(cloud.points)} points; give (points, {CHANNELS})"
            )
        total = cloud.log_scores.copy()
        sound = bound_rows(total, self._classes)
        self._counts["points_with_unsound_lidar_scores"] += int(np.sum(~sound))
        return total, cloud.evidence & usable & sound

    def _add_scores(
        self,
        total: NDArray[np.float32],
        evidence: NDArray[np.bool_],
        view: View,
        image: ClassScores,
    ) -> NDArray[np.bool_]:
        """Multiply an image's scores in; which points of the view it spoke of."""
        if image.grid.ndim != 4 or image.grid.shape[3] != CHANNELS:
            raise StageError(
                f"scores of '{image.camera}': grid of shape {image.grid.shape}; "
                f"give (tiles, rows, columns, {CHANNELS})"
            )
        rows, said = sample_scores(
            locked(image.grid),
            as_input(image.rects),
            image.scale,
            float(image.zero_point),
            view.pixel,
            self._classes,
        )
        sound = bound_rows(rows, self._classes)
        self._counts["points_with_unsound_image_scores"] += int(np.sum(~sound))
        said &= sound
        accumulate(total, evidence, view.index, rows, said, self._classes)
        return np.asarray(said)

    def _claims(
        self,
        points: NDArray[np.float32],
        shape: tuple[int, int] | None,
        view: View,
        found: Detections,
        source: int,
    ) -> list[Claim]:
        """What the boxes of one detector say of the points."""
        claims = []
        for number, (box, score) in enumerate(zip(found.boxes, found.scores, strict=True)):
            label = int(found.classes[number])
            if not 0 <= label < self._classes:
                raise StageError(
                    f"boxes of '{found.camera}': class {label} is none of the taxonomy's "
                    f"0..{self._classes - 1}"
                )
            if not (np.isfinite(box).all() and np.isfinite(score)):
                self._counts["boxes_unsound"] += 1
                continue
            inside = points_in_box(view.pixel, as_input(box))
            index, distance = view.index[inside], view.distance[inside]
            member = self._members(points, shape, index, distance)
            claims.append(
                Claim(index, view.pixel[inside], member, as_input(box), label, float(score), source)
            )
        return claims

    def _members(
        self,
        points: NDArray[np.float32],
        shape: tuple[int, int] | None,
        index: NDArray[np.int64],
        distance: NDArray[np.float32],
    ) -> NDArray[np.bool_]:
        """Which of a box's points, at `distance` (j,) from the camera, are the object."""
        first = seed(distance)
        if first < 0 or self._foreground == "box":
            return np.ones(len(index), dtype=np.bool_)
        seed_m = float(distance[first])
        if self._foreground == "depth":
            return near_depth(distance, seed_m, self._foreground_m)
        tau = reach_m(seed_m, self._pitch_rad)
        if shape is None:
            return np.asarray(cluster(points, index, first, tau))
        return np.asarray(cluster_organized(points, index, first, tau, *shape, self._pitch_rad))

    def _leave_out(self, what: str, why: str, stamp: int) -> None:
        if not self._counts[what]:
            log.warning("%s (first at stamp %d); counted as %s from here on", why, stamp, what)
        self._counts[what] += 1


def _rows_of(claims: list[Claim], rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """A copy of the rows that some box claims; the others are left open, since copying all of them
    is a tenth of the stage's time."""
    copied = np.empty_like(rows)
    for claim in claims:
        copied[claim.index] = rows[claim.index]
    return copied
