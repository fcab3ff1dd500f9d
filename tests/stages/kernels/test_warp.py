"""The warp of an image by depth and motion, against points moved one by one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stages.kernels.geometry import rotation_exp
from stages.kernels.projection import fold_limit, project, unproject
from stages.kernels.warp import to_meters, viewing_rays, warp

WIDTH, HEIGHT = 40, 30
PLAIN = np.array([35, 36, 19.5, 14.5, 0, 0, 0, 0, 0], np.float64)
DISTORTED = np.array([35, 36, 19.5, 14.5, -0.1, 0.02, 1e-3, -1e-3, 0.001])


def motion(forward: float = 0.0, right: float = 0.0, turn: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rotation_exp(np.array([0.0, turn, 0.0]))
    pose[:3, 3] = right, 0, forward
    return pose


def warped(
    before: np.ndarray, now: np.ndarray, now_from_before: np.ndarray, intrinsics: np.ndarray = PLAIN
) -> np.ndarray:
    height, width = now.shape
    rays = viewing_rays(width, height, intrinsics)
    source, count = warp(before, now, rays, now_from_before, intrinsics, fold_limit(intrinsics))
    assert count == (source >= 0).sum()
    return source


def flat(depth_m: float) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), depth_m, np.float32)


@pytest.mark.parametrize("intrinsics", [PLAIN, DISTORTED])
def test_without_motion_every_pixel_stays(intrinsics: np.ndarray) -> None:
    source = warped(flat(5), flat(5), np.eye(4), intrinsics)
    np.testing.assert_array_equal(source.ravel(), np.arange(WIDTH * HEIGHT))


def test_a_step_to_the_side_shifts_by_focal_length_over_depth() -> None:
    source = warped(flat(7), flat(7), motion(right=-0.6))  # the camera moved right: 35 * 0.6 / 7
    rows, columns = np.divmod(source[:, : WIDTH - 3], WIDTH)
    np.testing.assert_array_equal(rows, np.mgrid[:HEIGHT, : WIDTH - 3][0])
    np.testing.assert_array_equal(columns, np.mgrid[:HEIGHT, 3:WIDTH][1])
    assert (source[:, WIDTH - 3 :] == -1).all()


@pytest.mark.parametrize("intrinsics", [PLAIN, DISTORTED])
def test_each_pixel_goes_where_its_point_is_projected(intrinsics: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    before = rng.uniform(3, 9, (HEIGHT, WIDTH)).astype(np.float32)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    points = unproject(pixel, before.ravel().astype(np.float64), intrinsics).astype(np.float32)
    move = motion(forward=-0.4, right=0.2, turn=0.02)
    usable = np.ones(len(points), np.bool_)
    index, target, _ = project(
        points, usable, move, intrinsics, WIDTH, HEIGHT, fold_limit(intrinsics)
    )
    depth = (points @ move[2, :3] + move[2, 3])[index]
    # The oracle's z-buffer: farthest first, so that the nearest is written last.
    nearest = np.full((HEIGHT, WIDTH), np.inf)
    expected = np.full((HEIGHT, WIDTH), -1)
    center = np.floor(target.astype(np.float64) + 0.5).astype(int)
    for i in np.argsort(-depth, kind="stable"):
        nearest[center[i, 1], center[i, 0]] = depth[i]
        expected[center[i, 1], center[i, 0]] = index[i]
    now = np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)
    source = warped(before, now, move, intrinsics)
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[1:-1, 1:-1] = True  # `project` ends at the border pixels' centers
    assert (source == expected)[inside].mean() > 0.998  # rounding at half a pixel
    assert (source >= 0).mean() > 0.5


def test_what_a_foreground_uncovers_has_no_past() -> None:
    before, now = flat(10), flat(10)
    before[10:20, 10:20] = 4
    now[10:20, 20:30] = 4  # it moved; the camera did not
    source = warped(before, now, np.eye(4))
    assert (source[10:20, 10:30] == -1).all()
    assert (source >= 0).sum() == WIDTH * HEIGHT - 200


@pytest.mark.parametrize("hole", ["before", "now"])
def test_a_pixel_without_depth_before_or_now_has_no_past(hole: str) -> None:
    before, now = flat(5), flat(5)
    (before if hole == "before" else now)[3, 4] = 0
    assert np.argwhere(warped(before, now, np.eye(4)) < 0).tolist() == [[3, 4]]


def test_points_that_come_behind_the_camera_have_no_place() -> None:
    assert (warped(flat(5), flat(5), motion(forward=-6)) == -1).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_pose_without_sense_warps_nothing(bad: float) -> None:
    move = np.eye(4)
    move[0, 3] = move[2, 3] = bad
    assert (warped(flat(5), flat(5), move) == -1).all()


def test_depth_counts_become_meters_within_the_sensor_s_reach() -> None:
    counts = np.array([[0, 399, 400, 20_000, 20_001, 65_535]], np.uint16)
    meters, count = to_meters(counts, 0.001, 0.4, 20.0)
    np.testing.assert_allclose(meters, [[0, 0, 0.4, 20, 0, 0]], rtol=1e-6)
    assert count == 2


@pytest.mark.parametrize("unit", [0.0, -0.001, np.nan, np.inf])
def test_a_depth_unit_without_sense_gives_no_depth(unit: float) -> None:
    meters, count = to_meters(np.full((2, 2), 1000, np.uint16), unit, 0.0, 20.0)
    assert count == 0
    assert (meters == 0).all()


def test_the_warp_of_rendered_rooms_brings_back_their_picture(shared: Path) -> None:
    """Each image warped into the next differs by 2.7 gray levels, unmoved by 7.5."""
    folder = shared / "data" / "rgbd_samples"
    lines = (folder / "trajectory.log").read_text().splitlines()
    blocks = [lines[first + 1 : first + 5] for first in range(0, 25, 5)]
    poses = [np.array([row.split() for row in block], np.float64) for block in blocks]
    intrinsics = np.array([525, 525, 319.5, 239.5, 0, 0, 0, 0, 0], np.float64)
    frames = []
    for number in range(5):
        gray = cv2.imread(str(folder / "color" / f"{number:05d}.jpg"), cv2.IMREAD_GRAYSCALE)
        counts = cv2.imread(str(folder / "depth" / f"{number:05d}.png"), cv2.IMREAD_UNCHANGED)
        assert gray is not None
        assert counts is not None
        frames.append((gray.astype(float), to_meters(counts, 0.001, 0.1, 20.0)[0]))
    warped_error, still_error = [], []
    for number in range(4):
        (before, depth_before), (now, depth_now) = frames[number], frames[number + 1]
        move = np.linalg.inv(poses[number + 1]) @ poses[number]
        source = warped(depth_before, depth_now, move, intrinsics)
        known = source >= 0
        assert known.mean() > 0.8
        warped_error.append(np.abs(before.ravel()[source[known]] - now[known]).mean())
        still_error.append(np.abs(before - now)[known].mean())
    assert np.mean(warped_error) < np.mean(still_error) / 2.5
