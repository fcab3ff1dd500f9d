"""Ten thousand odd inputs through what has no such test beside its own: nothing raises, no NaN gets
out, and what was spoiled is counted.

The others: clusters and claims (test_foreground), range images (test_range_image), fused images
with warp and depth (test_fuse_image), the voxel map and its horizons (test_voxel_map).
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from pipeline.message import Message
from stages.fuse_cloud import FuseCloud
from stages.kernels.class_groups import grouped_log_scores, membership
from stages.kernels.compiled import as_input
from stages.kernels.evaluation import agreement, scan_confusion
from stages.kernels.map_query import select
from stages.kernels.neighbors import Cubes, nearest
from stages.kernels.network_input import fitted, in_color_order, placement
from stages.kernels.probability import read_out, softmax
from stages.kernels.projection import project, unproject
from stages.kernels.render import blend_classes, top_view
from stages.kernels.sharpness import sharpness
from stages.thermal_agc import ThermalAgc
from stages.types import (
    CHANNELS,
    Calibration,
    ClassScores,
    Cloud,
    Detections,
    Image,
    Pose,
    Scan,
)

pytestmark = pytest.mark.slow

ROUNDS = 10_000
C = 15
ODD = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e38, -1e38, 1e-40])
FORWARD = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
TENTH = 100_000_000


def calibration(distortion: list[float]) -> Calibration:
    lens = {"size": [64, 48], "fx": 40, "fy": 40, "cx": 31.5, "cy": 23.5, "distortion": distortion}
    return Calibration.parse(
        {
            "lidar": {"base_from_sensor": np.eye(4).tolist()},
            "rgb": {"base_from_sensor": FORWARD, "camera": lens},
        }
    )


def spoil(rng: np.random.Generator, values: np.ndarray, share: float = 0.15) -> np.ndarray:
    """The same with some values odd, or all alike."""
    if rng.random() < 0.1 and values.size:
        values[...] = values.flat[0]
    if rng.random() < 0.5:
        values[rng.random(values.shape) < share] = rng.choice(ODD)
    return values


def points(rng: np.random.Generator, least: int = 0) -> np.ndarray:
    """Before and behind the camera, from none to a few dozen, near, far and odd."""
    n = int(rng.choice([0, 1, 2, 40])) or least
    scale = 10 ** rng.uniform(-3, 6) if rng.random() < 0.2 else 8.0
    return spoil(rng, rng.normal(0, scale, (n, 3)).astype(np.float32))


def odd_scores(rng: np.random.Generator, stamp: int) -> Message[ClassScores]:
    kind = rng.choice(["f4", "i1", "u1"])
    rows, columns = (int(k) for k in rng.choice([1, 2, 7], 2))
    if kind == "f4":
        grid = spoil(rng, rng.normal(0, 3, (1, rows, columns, CHANNELS)).astype(np.float32))
    else:
        grid = rng.integers(0, 100, (1, rows, columns, CHANNELS)).astype(kind)
    rects = np.array([[0, 0, 64, 48]], np.float32)
    scale = float(rng.choice([1.0, 0.1, 0.0]))
    return Message.at(stamp, ClassScores(grid, rects, scale, 3, "rgb", (64, 48)))


def odd_boxes(rng: np.random.Generator, stamp: int) -> Message[Detections]:
    n = int(rng.choice([0, 1, 3]))
    boxes = spoil(rng, rng.uniform(-20, 90, (n, 4)).astype(np.float32))
    scores = spoil(rng, rng.random(n).astype(np.float32))
    return Message.at(stamp, Detections(boxes, rng.integers(0, C, n), scores, "rgb"))


def odd_path(rng: np.random.Generator) -> tuple[Message[Pose], ...]:
    """None, one that ends before the image, one with jumps."""
    if rng.random() < 0.3:
        return ()
    shift = rng.normal(0, 1, (3, 3))
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = shift
    first = int(rng.choice([-4, -1, 0])) * TENTH
    return tuple(Message.at(first + k * TENTH, Pose(pose)) for k, pose in enumerate(poses))


def odd_cloud(rng: np.random.Generator) -> Message[Any]:
    where = points(rng)
    n = len(where)
    times = rng.integers(-50_000_000, 50_000_000, n).astype(np.int32)
    shape = (1, n) if n and rng.random() < 0.3 else None
    if rng.random() < 0.5:
        return Message.at(0, Scan(where, None, times, shape, "lidar"))
    scores = spoil(rng, rng.normal(0, 3, (n, CHANNELS)).astype(np.float32))
    return Message.at(0, Cloud(where, scores, rng.random(n) < 0.8, None, "lidar", times, shape))


def test_clouds_images_boxes_and_poses_fuse_to_finite_scores_and_spoiled_ones_are_counted() -> None:
    rng = np.random.default_rng(0)
    lenses = ([0.0] * 5, [-0.3, 0.1, 1e-3, -1e-3, 0.0], [5.0, -9.0, 0.1, 0.1, 3.0])
    stages = [
        FuseCloud(calibration=calibration(lens), foreground=foreground, occlusion_deg=occlusion)  # type: ignore[arg-type]
        for lens, foreground, occlusion in zip(
            lenses, ("cluster", "depth", "box"), (0.0, 2.0, 0.0), strict=True
        )
    ]
    for number in range(ROUNDS):
        stage = stages[number % 3]
        cloud = odd_cloud(rng)
        scores = tuple(odd_scores(rng, int(rng.choice([0, TENTH // 2]))) for _ in range(2))
        with np.errstate(all="ignore"), warnings.catch_warnings(record=True):
            fused = stage.process(cloud, scores, (odd_boxes(rng, 0), None), odd_path(rng))
        assert np.isfinite(fused.log_scores[:, :C]).all()
        p = softmax(fused.log_scores, C)
        np.testing.assert_allclose(p.sum(axis=1), 1.0, atol=1e-5)
        assert fused.voted is not None
        np.testing.assert_array_equal(fused.voted != 0, fused.evidence)
        assert np.isfinite(fused.points[fused.evidence]).all()
    for stage in stages:
        counted = stage.statistics()
        for name in (
            "points_with_evidence",
            "points_with_unsound_lidar_scores",
            "points_with_unsound_image_scores",
            "boxes_unsound",
            "stamps_without_pose",
        ):
            assert counted[name] > 0, name
    assert stages[1].statistics()["points_hidden"] > 0


def test_what_a_camera_sees_lies_in_its_image_and_before_it() -> None:
    rng = np.random.default_rng(1)
    for _ in range(ROUNDS):
        where = points(rng)
        intrinsics = np.array([40, 40, 31.5, 23.5, *rng.normal(0, 0.5, 5)])
        pose = np.eye(4)
        pose[:3, 3] = rng.normal(0, 2, 3)
        index, pixel, distance = project(
            as_input(where), np.ones(len(where), bool), pose, intrinsics, 64, 48, 2.0
        )
        assert (where[index, 2] + pose[2, 3] > 0).all()
        assert ((pixel >= 0) & (pixel <= (63, 47))).all()
        assert np.isfinite(distance).all()
        with np.errstate(all="ignore"):
            unproject(pixel.astype(np.float64), distance.astype(np.float64), intrinsics)


@pytest.mark.parametrize("mode", ["linear", "plateau", "clahe"])
def test_thermal_frames_of_any_content_become_8_bit(mode: Any) -> None:
    rng = np.random.default_rng(2)
    gain = ThermalAgc(mode=mode)
    for _ in range(ROUNDS // 10):  # a table has 65,536 entries
        height, width = (int(k) for k in rng.choice([0, 1, 2, 33], 2))
        raw = rng.integers(0, 65_536, (height, width)).astype(np.uint16)
        if rng.random() < 0.4:
            raw[...] = rng.choice([0, 1, 7000, 65_535])
        elif rng.random() < 0.5:
            raw = raw % 20 + 7000
        raw.flat[: int(rng.integers(3))] = 65_535
        frame = gain.process(Message.at(0, Image(raw.astype(np.uint16), "thermal"))).data
        assert (frame.dtype, frame.shape) == (np.uint8, raw.shape)


def test_images_of_any_size_reach_a_network_in_its_own() -> None:
    rng = np.random.default_rng(3)
    for _ in range(ROUNDS):
        height, width, wide, high = (int(k) for k in rng.choice([1, 2, 3, 17], 4))
        color = bool(rng.integers(2))
        image = rng.integers(0, 256, (height, width, 3) if color else (height, width), np.uint8)
        letterbox = bool(rng.integers(2))
        picture = fitted(image, (wide, high), letterbox=letterbox)
        assert picture.shape[:2] == (high, wide)
        for order in ("rgb", "bgr") if color else ("gray",):
            assert in_color_order(picture, order).shape[:2] == (high, wide)
        assert np.isfinite(placement((width, height), (wide, high), letterbox=letterbox)).all()


def test_network_classes_merge_to_finite_log_scores() -> None:
    rng = np.random.default_rng(4)
    member = membership({0: 1, 1: 1, 2: 13, 3: 3}, 5, CHANNELS)
    for _ in range(ROUNDS):
        logits = rng.normal(0, 10 ** rng.uniform(-3, 4), (int(rng.integers(0, 9)), 5))
        if rng.random() < 0.2:
            logits[...] = 7.0
        scores = grouped_log_scores(
            logits.astype(np.float32), member, C, temperature=1.0, padding=-1e4
        )
        assert np.isfinite(scores).all()
        label, confidence, entropy = read_out(as_input(scores), C)
        assert (label < C).all()
        assert np.isfinite(confidence).all()
        assert np.isfinite(entropy).all()


def test_maps_of_any_content_are_asked_measured_and_judged() -> None:
    rng = np.random.default_rng(5)
    for _ in range(ROUNDS):
        n = int(rng.choice([0, 1, 2, 12]))
        where = spoil(rng, rng.normal(0, 2, (n, 3)), 0.05)
        finite = np.isfinite(where).all(axis=1) & (np.abs(where) < 1e6).all(axis=1)
        scores = np.minimum(rng.normal(0, 20, (n, CHANNELS)), 0).astype(np.float32)
        label, _, entropy = read_out(as_input(scores), C)
        rows = select(
            where.astype(np.float32), scores, C, center=(0, 0, 0), radius_m=2.0, max_entropy=1.0
        )
        assert set(rows) <= set(range(n))
        where, label, entropy = where[finite], label[finite].astype(np.int64), entropy[finite]
        measured, by_class = sharpness(where, label, entropy, 0.5)
        assert measured.voxels == np.count_nonzero(label)
        assert sum(each.voxels for each in by_class.values()) == measured.voxels
        row = nearest(Cubes.of(where, 0.5), where + 0.1)
        assert (row < len(where)).all()
        found = agreement(scan_confusion(label, np.where(row >= 0, label[row], 0) if n else label))
        assert ((found.iou >= 0) & (found.iou <= 1) | np.isnan(found.iou)).all()


def test_pictures_of_any_size_are_drawn() -> None:
    rng = np.random.default_rng(6)
    colors = rng.integers(0, 256, (C, 3)).astype(np.uint8)
    for _ in range(ROUNDS):
        height, width = (int(k) for k in rng.choice([1, 2, 9], 2))
        image = rng.integers(0, 256, (height, width, 3)).astype(np.uint8)
        labels = rng.integers(0, C, (height, width)).astype(np.uint8)
        assert blend_classes(image, labels, colors, rng.random()).shape == image.shape
        n = int(rng.choice([0, 1, 5]))
        where = rng.normal(0, 3, (n, 3)).astype(np.float32)
        view = top_view(where, rng.integers(0, C, n).astype(np.uint8), colors, 0.5, 2)
        assert view.ndim == 3
