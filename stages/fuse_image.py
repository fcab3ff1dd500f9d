"""Fuse a camera's segmentation with its own past and with detections (eq 6, 7)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.message import Message, Span
from pipeline.stage import Stage
from stages.frames import map_from_sensor, mounted
from stages.fused import FusedImage, FusionStatus
from stages.kernels.compiled import as_input, locked
from stages.kernels.geometry import invert
from stages.kernels.image_detection import (
    detect,
    foreground,
    pixels_in_other,
    share_of_box,
    share_of_other,
)
from stages.kernels.image_fusion import fuse_rows
from stages.kernels.projection import fold_limit
from stages.kernels.warp import to_meters, viewing_rays, warp
from stages.taxonomy import load_taxonomy
from stages.types import (
    CHANNELS,
    Calibration,
    Camera,
    ClassScores,
    DepthImage,
    Detections,
    Pose,
    Trajectory,
)

NOWHERE = Calibration()
NO_PAST = np.zeros((0, 0), dtype=np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A camera with depth at one instant."""

    depth: NDArray[np.float32]  #: (height, width) m, 0 = none
    rays: NDArray[np.float32]  #: (2, height, width)
    model: Camera
    map_from_camera: NDArray[np.float64] | None  #: (4, 4); None where no pose covers the instant


@dataclass(frozen=True, slots=True, eq=False)
class _Past:
    """What is kept of a camera's last image."""

    stamp: int
    probabilities: NDArray[np.float32]  #: (height, classes, width), after its detections
    view: _View | None
    spare: NDArray[np.float32] | None  #: a buffer of the same shape to write into next


class FuseImage(Stage):
    """The semantic mask of a camera: segmentation, smoothed over time, times detections.

    The last fused image is warped into the present one by its depth and the vehicle's motion and
    blended with the present by class: things that move follow the present, the rest stays calm.
    Detections then multiply in, on the pixels of the object in front; boxes of another camera
    (thermal) are carried over by the depth of each pixel. What was fused is the next image's past,
    so a detection fades over some images.

    Without `depth` there is no smoothing, and boxes of this camera count with their Gaussian alone;
    without a `trajectory` the vehicle is taken as standing still. `FusedImage.status` says what was
    missing, `statistics` counts it. Give `depth` and `boxes` with ``sync: exact``, where the depth
    is stamped as the image. Each camera has its own past.
    """

    def __init__(
        self,
        *,
        calibration: Calibration = NOWHERE,
        share_dynamic: float = 0.80,
        share_static: float = 0.25,
        smooth: bool = True,
        max_gap_s: float = 0.5,
        depth_m: tuple[float, float] = (0.4, 20.0),
        growth: float = 0.03,
        probabilities: bool = False,
    ) -> None:
        """`share_dynamic` and `share_static` weigh the present image for classes that move by
        themselves and for the others. `smooth` false leaves the past out. `max_gap_s`: a past older
        than this is dropped. `depth_m`: the nearest and farthest depth to trust. `growth`: by which
        part of its depth neighboring pixels of one object may differ in depth; 0.03 bridges the
        noise of a stereo camera (about 2 % at 4 m) and ends at what stands 0.3 m behind at 10 m.
        `probabilities` adds all classes' probabilities to the result, at a new buffer per image.
        """
        for name, value in (("share_dynamic", share_dynamic), ("share_static", share_static)):
            if not 0 < value <= 1:
                raise ValueError(f"{name} must be above 0 and at most 1, not {value}")
        for name, value in (("max_gap_s", max_gap_s), ("growth", growth)):
            if not value > 0:
                raise ValueError(f"{name} must be above 0, not {value}")
        if not 0 <= depth_m[0] < depth_m[1]:
            raise ValueError(f"depth_m must be [nearest, farthest] in meters, not {depth_m}")
        self._calibration = calibration
        dynamic = load_taxonomy().dynamic
        self._share = np.where(dynamic, share_dynamic, share_static).astype(np.float32)
        self._smooth = smooth
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._depth_m = depth_m
        self._growth = growth
        self._publish = probabilities
        self._past: dict[str, _Past] = {}
        self._rays: dict[Camera, NDArray[np.float32]] = {}
        self._counts: Counter[str] = Counter()

    def open(self) -> None:
        """Compile the kernels (or load them from the cache) now, not during the first image."""
        box = np.array([[0, 0, 1, 1]], dtype=np.float32)
        depth = DepthImage(np.array([[1000, 1000], [1000, 0]], np.uint16), 0.001, "a")
        one = np.ones(1, np.int64), np.ones(1, np.float32)
        for kind in (np.float32, np.int8, np.uint8):
            grid = np.zeros((1, 2, 2, CHANNELS), dtype=kind)
            scores = ClassScores(grid, 2 * box, 1.0, 0, "a", (2, 2))
            shadow = FuseImage(calibration=_ANYWHERE)
            for stamp in (0, 1):  # the second has a past
                shadow.process(
                    Message.at(stamp, scores),
                    Message.at(stamp, Detections(box, *one, "a")),
                    Message.at(stamp, Detections(box, *one, "b")),
                    Message.at(stamp, depth),
                )

    def statistics(self) -> Mapping[str, int]:
        """How many images had to do without what."""
        return dict(self._counts)

    def process(
        self,
        scores: Message[ClassScores],
        boxes: Message[Detections] | None = None,
        thermal: Message[Detections] | None = None,
        depth: Message[DepthImage] | None = None,
        trajectory: Span[Pose] = (),
    ) -> FusedImage:
        image = scores.payload
        path = Trajectory.of(trajectory) if trajectory else None
        view, status = self._view(image, depth, scores.stamp, path)
        past, source, smoothed, lost = self._source(scores, view)
        status |= lost
        fused, mask, confidence, spoiled = self._blend(image, past, source)
        status |= spoiled
        for found in (boxes, thermal):
            if found:
                status |= self._add_boxes(fused, mask, confidence, found, scores, view, path)
        spare = None if past is None or self._publish else past.probabilities
        self._past[image.camera] = _Past(scores.stamp, fused, view, spare)
        self._counts["images"] += 1
        for flag in status:
            self._counts[str(flag.name).lower()] += 1
        every_class = locked(fused.transpose(1, 0, 2)) if self._publish else None
        return FusedImage(mask, confidence, every_class, image.camera, status, smoothed)

    def _view(
        self,
        image: ClassScores,
        depth: Message[DepthImage] | None,
        stamp: int,
        path: Trajectory | None,
    ) -> tuple[_View | None, FusionStatus]:
        """The camera with its depth, where there is any."""
        if depth is None:
            return None, FusionStatus.NO_DEPTH
        picture = depth.payload
        if picture.camera != image.camera or picture.depth.shape != image.size[::-1]:
            raise StageError(
                f"depth of '{picture.camera}' {picture.depth.shape[::-1]} for scores of "
                f"'{image.camera}' {image.size}; give depth aligned to that camera's pixels"
            )
        meters, count = to_meters(as_input(picture.depth), picture.unit_m, *self._depth_m)
        if count == 0:
            return None, FusionStatus.NO_DEPTH
        model = self._model(image)
        if model not in self._rays:
            self._rays[model] = locked(viewing_rays(*model.size, model.intrinsics()))
        pose: NDArray[np.float64] | None = np.eye(4)
        if path is not None:
            pose = map_from_sensor(self._calibration, image.camera, stamp, path)
        status = FusionStatus.NO_POSE if pose is None else FusionStatus(0)
        return _View(meters, self._rays[model], model, pose), status

    def _model(self, image: ClassScores) -> Camera:
        """The camera's model at the image's size, which may be a scaled one."""
        model = self._calibration.camera(image.camera)
        if model.size == image.size:
            return model
        (width, height), (full_width, full_height) = image.size, model.size
        across, down = width / full_width, height / full_height
        if abs(width * full_height - height * full_width) > max(model.size):  # over a pixel off
            raise StageError(
                f"scores of '{image.camera}' are {image.size}, its calibration says {model.size}; "
                "calibrate the camera at the size in use"
            )
        return replace(
            model,
            size=image.size,
            fx=model.fx * across,
            fy=model.fy * down,
            cx=(model.cx + 0.5) * across - 0.5,
            cy=(model.cy + 0.5) * down - 0.5,
        )

    def _source(
        self, scores: Message[ClassScores], view: _View | None
    ) -> tuple[_Past | None, NDArray[np.int32], float, FusionStatus]:
        """The camera's past, which of its pixels each pixel continues, and the share that does."""
        past = self._past.get(scores.payload.camera)
        if past is None:
            return None, NO_PAST, 0.0, FusionStatus.FIRST_IMAGE
        if past.probabilities.shape != self._shape(scores.payload):
            return None, NO_PAST, 0.0, FusionStatus.SIZE_CHANGED
        if not 0 < scores.stamp - past.stamp <= self._max_gap_ns:
            return past, NO_PAST, 0.0, FusionStatus.GAP
        before = past.view
        if not (self._smooth and view and before):
            return past, NO_PAST, 0.0, FusionStatus(0)
        if view.map_from_camera is None or before.map_from_camera is None:
            return past, NO_PAST, 0.0, FusionStatus(0)
        motion = invert(view.map_from_camera) @ before.map_from_camera
        intrinsics = view.model.intrinsics()
        source, count = warp(
            before.depth, view.depth, view.rays, motion, intrinsics, fold_limit(intrinsics)
        )
        return past, source, count / max(source.size, 1), FusionStatus(0)

    def _shape(self, image: ClassScores) -> tuple[int, int, int]:
        width, height = image.size
        return height, len(self._share), width

    def _blend(
        self, image: ClassScores, past: _Past | None, source: NDArray[np.int32]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32], FusionStatus]:
        """Probabilities, likeliest class and its probability after eq 6."""
        if image.grid.ndim != 4 or image.grid.shape[3] != CHANNELS:
            raise StageError(
                f"scores of '{image.camera}': grid of shape {image.grid.shape}; "
                f"give (tiles, rows, columns, {CHANNELS})"
            )
        shape = self._shape(image)
        mask = np.empty((shape[0], shape[2]), dtype=np.uint8)
        confidence = np.empty(mask.shape, dtype=np.float32)
        spare = past.spare if past else None
        fused = np.empty(shape, dtype=np.float32) if spare is None else spare
        spoiled, uncovered = fuse_rows(
            locked(image.grid),
            as_input(image.rects),
            image.scale,
            float(image.zero_point),
            self._share,
            past.probabilities if past else fused,
            source,
            fused,
            mask,
            confidence,
        )
        status = FusionStatus(0)
        if spoiled:
            status |= FusionStatus.SPOILED_SCORES
        if uncovered:
            status |= FusionStatus.UNCOVERED
        return fused, mask, confidence, status

    def _add_boxes(
        self,
        fused: NDArray[np.float32],
        mask: NDArray[np.uint8],
        confidence: NDArray[np.float32],
        found: Message[Detections],
        scores: Message[ClassScores],
        view: _View | None,
        path: Trajectory | None,
    ) -> FusionStatus:
        """Eq 7: each pixel gets only the strongest box of a class, as boxes of one detector
        overlap; a pixel without depth gets none of another camera's."""
        detections, camera = found.payload, scores.payload.camera
        if len(detections.boxes) == 0:
            return FusionStatus(0)
        pixels = None
        if detections.camera != camera:
            pixels = self._pixels_in_other(found, camera, view, path)
            if pixels is None:
                return FusionStatus.BOXES_LEFT_OUT
        claimed = np.zeros(mask.shape, dtype=np.uint16)
        spoiled = False
        for number in np.argsort(-detections.scores, kind="stable"):
            box, label = as_input(detections.boxes[number]), int(detections.classes[number])
            score = float(detections.scores[number])
            if not 0 <= label < len(self._share):
                raise StageError(
                    f"boxes of '{detections.camera}': class {label} is none of the taxonomy's "
                    f"0..{len(self._share) - 1}"
                )
            if not (np.isfinite(box).all() and np.isfinite(score)):
                spoiled = True
                continue
            if pixels is None:
                left, top, share = share_of_box(box, mask.shape[1], mask.shape[0])
                spoiled |= share.size == 0
            else:
                left, top, share = share_of_other(box, pixels)
            if share.size == 0:
                continue
            window = slice(top, top + share.shape[0]), slice(left, left + share.shape[1])
            members = share > 0
            if view is not None:
                # Contiguous, whatever the window: one kind of array, one compilation.
                depth = np.ascontiguousarray(view.depth[window])
                members = foreground(depth, share, self._growth)
            detect(fused, mask, confidence, claimed, left, top, share, members, score, label)
        return FusionStatus.SPOILED_BOXES if spoiled else FusionStatus(0)

    def _pixels_in_other(
        self,
        found: Message[Detections],
        camera: str,
        view: _View | None,
        path: Trajectory | None,
    ) -> NDArray[np.float32] | None:
        """Where the detections' camera, at its own instant, sees this one's pixels (eq 1)."""
        if view is None:
            return None
        other = found.payload.camera
        if path is None:
            other_from_camera = mounted(self._calibration, other, camera)
        else:
            map_from_other = map_from_sensor(self._calibration, other, found.stamp, path)
            if map_from_other is None or view.map_from_camera is None:
                return None
            other_from_camera = invert(map_from_other) @ view.map_from_camera
        intrinsics = self._calibration.camera(other).intrinsics()
        limit = fold_limit(intrinsics)
        pixels: NDArray[np.float32] = pixels_in_other(
            view.depth, view.rays, other_from_camera, intrinsics, limit
        )
        return pixels


#: Two cameras for compiling: at one place, of two pixels by two.
_ANYWHERE = Calibration.parse(
    {
        name: {
            "base_from_sensor": np.eye(4).tolist(),
            "camera": {"size": [2, 2], "fx": 2, "fy": 2, "cx": 0.5, "cy": 0.5},
        }
        for name in ("a", "b")
    }
)
