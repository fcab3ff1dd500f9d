"""What `kernels` measures: single kernels, the paths they form, and a whole frame in its stages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message
from pipeline.model import ModelSpec, Tensor
from stages.frames import View, look, mounted
from stages.fuse_cloud import FuseCloud
from stages.fuse_image import FuseImage
from stages.kernels.compiled import as_input
from stages.kernels.foreground import cluster, cluster_organized, points_in_box, reach_m, seed
from stages.kernels.image_fusion import colorize
from stages.kernels.probability import accumulate, bound_rows
from stages.kernels.sampling import sample_scores
from stages.scan_image import RangeImage
from stages.score_grid import ScoreGrid
from stages.segment_scan import SegmentScan
from stages.semantic_map import SemanticMap
from stages.taxonomy import load_taxonomy
from stages.types import (
    CHANNELS,
    ClassScores,
    Cloud,
    DepthImage,
    Detections,
    Pose,
    Scan,
)
from stages.voxel_map import VoxelMap
from tools.bench.kernel_scene import (
    CALIBRATION,
    CLASSES,
    ELEVATION_RAD,
    HEIGHT,
    SCAN,
    VEHICLE,
    VOXEL_M,
    WIDTH,
    Frame,
    log_scores,
)

POINTS = SCAN[0] * SCAN[1]
PITCH_RAD = np.pi / 2 / SCAN[0]
NETWORK = (64, 512)  #: rows and columns of the LiDAR network's range image
PROBABILITIES = 4 * HEIGHT * CLASSES * WIDTH  #: bytes of an image's


@dataclass(frozen=True, slots=True)
class Case:
    """One figure."""

    figure: str
    call: Callable[[], object]
    goal_ms: float | None = None
    moved: float = 0  #: bytes that a call cannot avoid to read or write; 0: no bound


def image_scores(labels: NDArray[np.uint8], stride: int, seed: int = 1) -> ClassScores:
    """A network's answer in cells of `stride` pixels, the outer ones on the image's corners; in
    full resolution as float32, else quantized."""
    v, u = (np.linspace(0, n - 1, -(-(n - 1) // stride) + 1).round() for n in labels.shape)
    scores = log_scores(labels[np.ix_(v.astype(int), u.astype(int))], seed)[None]
    corners = ScoreGrid((WIDTH, HEIGHT), align_corners=True)
    rect = np.array([corners.rect((0, 0, WIDTH, HEIGHT), scores.shape[1:3])], dtype=np.float32)
    if stride == 1:
        return ClassScores(scores, rect, 1.0, 0, "rgb", (WIDTH, HEIGHT))
    grid = np.clip(np.rint(scores / 0.1), -128, 127).astype(np.int8)
    return ClassScores(grid, rect, 0.1, 0, "rgb", (WIDTH, HEIGHT))


def points_cases(scene: Sequence[Frame]) -> Iterator[Case]:
    """Points seen by a camera take its scores: projected, sampled, bounded, multiplied in."""
    camera, chain = CALIBRATION.camera("rgb"), mounted(CALIBRATION, "rgb", "lidar")
    scores = image_scores(scene[0].labels, 1)
    usable = np.ones(POINTS, dtype=np.bool_)
    v, u = (axis.ravel() for axis in np.mgrid[0 : HEIGHT - 1 : 256j, 0 : WIDTH - 1 : 512j])
    depth = np.random.default_rng(0).uniform(3, 40, POINTS)
    ahead = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0 * u + 1], axis=1)
    from_camera = np.linalg.inv(chain)
    facing = (ahead * depth[:, None]) @ from_camera[:3, :3].T + from_camera[:3, 3]
    for words, points, goal in (
        ("15 % in view", scene[0].points, 2.6),
        ("all in view", facing.astype(np.float32), 6.5),
    ):
        total, evidence = np.zeros((POINTS, CHANNELS), np.float32), np.zeros(POINTS, np.bool_)
        call = partial(fuse_points, points, usable, chain, scores, total, evidence)
        seen = len(call().index)
        moved = 13 * POINTS + min(256 * seen, scores.grid.nbytes) + 128 * seen
        yield Case(f"points fused, {words} ({seen:,} of {POINTS:,})", call, goal, moved)


def fuse_points(
    points: NDArray[np.float32],
    usable: NDArray[np.bool_],
    camera_from_lidar: NDArray[np.float64],
    scores: ClassScores,
    total: NDArray[np.float32],
    evidence: NDArray[np.bool_],
) -> View:
    """Eq 1-3 as `FuseCloud` computes them for an image."""
    view = look(CALIBRATION.camera("rgb"), points, usable, camera_from_lidar)
    rows, said = sample_scores(scores.grid, scores.rects, 1.0, 0.0, view.pixel, CLASSES)
    said &= bound_rows(rows, CLASSES)
    accumulate(total, evidence, view.index, rows, said, CLASSES)
    return view


def cluster_cases(scene: Sequence[Frame]) -> Iterator[Case]:
    """The object in a box of 4,000 points (eq 5)."""
    points, camera = scene[0].points, CALIBRATION.camera("rgb")
    usable = (points**2).sum(axis=1) > 1
    view = look(camera, points, usable, mounted(CALIBRATION, "rgb", "lidar"))
    low, high = np.split(scene[0].boxes["rgb"][0], 2)
    rows = points_in_box(view.pixel, np.concatenate([low, high]))
    while len(rows) < 4_000:
        low, high = low - 2, high + 2
        rows = points_in_box(view.pixel, np.concatenate([low, high]))
    index, distance = view.index[rows], view.distance[rows]
    first = seed(distance)
    tau = reach_m(float(distance[first]), PITCH_RAD)
    points = as_input(points)
    found = np.count_nonzero(cluster(points, index, first, tau))
    size = f"{len(rows):,} points in the box, {found:,} in the object"
    box = points, index, first, tau
    yield Case(f"cluster, any cloud ({size})", partial(cluster, *box), 0.35)
    organized = partial(cluster_organized, *box, *SCAN, PITCH_RAD)
    yield Case(f"cluster, organized scan ({size})", organized, 0.35)


def range_cases(scene: Sequence[Frame]) -> Iterator[Case]:
    """A scan becomes the LiDAR network's input."""
    points, remission = scene[0].points, np.full(POINTS, 0.5, dtype=np.float32)
    mean, std = np.zeros(5, dtype=np.float32), np.ones(5, dtype=np.float32)
    cells = NETWORK[0] * NETWORK[1]
    for words, shape, goal, read in (
        ("projected", None, 1.3, POINTS),
        ("organized", SCAN, 0.1, cells),
    ):
        image, scan = RangeImage(NETWORK, ELEVATION_RAD), Scan(points, remission, None, shape, "")
        yield Case(
            f"range image {NETWORK[1]} x {NETWORK[0]}, {words}",
            partial(image.channels, scan, mean, std),
            goal,
            16 * read + 20 * cells,
        )


def map_cases(scene: Sequence[Frame], few: int, many: int) -> tuple[list[Case], float]:
    """A scan into maps of `few` and `many` voxels; and the bytes per voxel of the large one."""
    clouds = [scored_cloud(frame) for frame in scene]
    own = VoxelMap(voxel_m=VOXEL_M, classes=CLASSES)
    own.integrate(*clouds[0], 0)
    moved = 77 * POINTS + own.used * (2 * (64 + 16) + 4 + 8)
    for cloud, pose in clouds[1:]:
        own.integrate(cloud, pose, 0)
    flown = (own.snapshot().indices + 0.5) * VOXEL_M
    rng = np.random.default_rng(0)
    cases = []
    for size, strewn in ((few, False), (many, False), (many, True)):
        others = rng.uniform((-200, -200, 300), (200, 200, 700), (size - len(flown), 3))
        centers = np.concatenate([flown, others])
        grown = VoxelMap(voxel_m=VOXEL_M, classes=CLASSES)
        for part in np.array_split(rng.permutation(centers) if strewn else centers, 50):
            nothing, said = (
                np.zeros((len(part), CHANNELS), np.float32),
                np.ones(len(part), np.bool_),
            )
            grown.integrate(Cloud(part.astype(np.float32), nothing, said, None, ""), np.eye(4), 0)
        cases.append(
            Case(
                f"a scan into a map of {grown.used:,} voxels, "
                + ("strewn over memory" if strewn else "numbered as flown"),
                partial(_integrate_next, grown, cycle(clouds)),
                5.0 if size == few else 10.0,
                moved,
            )
        )
    return cases, grown.nbytes / grown.used


def scored_cloud(frame: Frame) -> tuple[Cloud, NDArray[np.float64]]:
    """The scan with scores, evidence where it has a return, and its pose."""
    returned = (frame.points**2).sum(axis=1) > 1
    scores = log_scores(frame.point_labels, 2)
    return Cloud(frame.points, scores, returned, None, "lidar"), frame.map_from_base


def _integrate_next(grown: VoxelMap, clouds: Iterator[tuple[Cloud, NDArray[np.float64]]]) -> None:
    grown.integrate(*next(clouds), 0)


class Flight:
    """The stages of fusion and map at steady state, fed with the scene to and fro at 10 Hz."""

    def __init__(self, scene: Sequence[Frame], stride: int) -> None:
        self._scene = [(frame, *self._said(frame, stride)) for frame in scene]
        self._turn = cycle([*range(len(scene)), *range(len(scene) - 2, 0, -1)])
        self._stamps = count(0, 100_000_000)
        self.segment, self.cloud, self.image, self.map = fusion_stages()
        self._colors = load_taxonomy().colors
        self._next()

    @staticmethod
    def _said(frame: Frame, stride: int) -> tuple[Any, ...]:
        """What the networks say of a frame."""
        lidar = log_scores(frame.point_labels.reshape(SCAN)[::2, ::2], 3)[None]
        found = []
        for name, boxes in frame.boxes.items():
            kept = boxes[: 5 if name == "rgb" else 3]
            labels, sure = np.full(len(kept), VEHICLE), np.full(len(kept), 0.8, np.float32)
            found.append(Detections(kept, labels, sure, name))
        return image_scores(frame.labels, stride), {"scores": Tensor(lidar)}, found

    def _next(self) -> None:
        stamp = next(self._stamps)
        frame, scores, self._lidar, found = self._scene[next(self._turn)]
        sweep = np.tile(np.linspace(-5e7, 5e7, SCAN[1]).astype(np.int32), SCAN[0])
        remission = np.full(POINTS, 0.5, dtype=np.float32)
        self._scan = Message.at(stamp, Scan(frame.points, remission, sweep, SCAN, "lidar"))
        self._scores = Message.at(stamp, scores)
        self._boxes = tuple(Message.at(stamp, each) for each in found)
        self._depth = Message.at(stamp, DepthImage(frame.depth, 0.001, "rgb"))
        pose = Pose(frame.map_from_base)
        self._poses = tuple(Message.at(stamp + t, pose) for t in (-(10**8), 0, 10**8))

    def image_path(self) -> None:
        """Depth and warp, soft-max, blend, detections, likeliest class, color."""
        self._next()
        self._fuse_image()

    def frame(self) -> None:
        """The image path and the cloud's: range image, back to points, fusion, map."""
        self._next()
        self._fuse_image()
        self.segment.prepare(self._scan)
        scored = Message.at(self._scan.stamp, self.segment.finish(self._lidar, self._scan))
        fused = self.cloud.process(scored, (self._scores,), self._boxes, self._poses)
        self.map.process(Message.at(self._scan.stamp, fused))

    def _fuse_image(self) -> None:
        boxes, thermal = self._boxes
        fused = self.image.process(self._scores, boxes, thermal, self._depth, self._poses)
        colorize(fused.mask, self._colors)


def fusion_stages() -> tuple[SegmentScan, FuseCloud, FuseImage, SemanticMap]:
    """The stages of fusion and map, opened."""
    segment = SegmentScan()
    segment.model = ModelSpec("lidar", "image", (*NETWORK, 5), "float32", "", {"kind": "scores"})
    stages = (
        segment,
        FuseCloud(calibration=CALIBRATION),
        FuseImage(calibration=CALIBRATION),
        SemanticMap(publish_every=1 << 30),  # a snapshot is the reader's cost
    )
    for stage in stages:
        stage.open()
    return stages
