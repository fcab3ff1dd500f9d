"""Each rule of label propagation on a street of a few points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_street import BUILDING, PERSON, ROAD, SKY, VEHICLE, observation, world, written

from pipeline.errors import DataError
from tools.propagation.settings import GroundFix, Settings, Teacher
from tools.propagation.teaching import Labeled, build_map, label_scans

PLAIN = Settings(ground=GroundFix.NONE)


def propagated(files: list[Path], settings: Settings) -> list[Labeled]:
    built = None if settings.teacher is Teacher.OVERLAY else build_map(files, settings)
    return list(label_scans(files, settings, built))


def spot(x: float, y: float, z: float, n: int = 3) -> np.ndarray:
    """A few points of one voxel."""
    return np.tile([x + 0.1, y + 0.1, z + 0.1], (n, 1)) + 0.01 * np.arange(n)[:, None]


def test_a_scan_is_labeled_behind_the_camera_by_what_other_scans_saw(tmp_path: Path) -> None:
    files = written(tmp_path, [observation(k, x) for k, x in enumerate([-10.0, -5, 0, 4])])
    _, true = world()
    last = propagated(files, PLAIN)[-1]
    assert np.count_nonzero(last.labels) > 0.95 * len(true)
    given = last.labels > 0
    np.testing.assert_array_equal(last.labels[given], true[given])
    overlay = propagated(files, replace(PLAIN, teacher=Teacher.OVERLAY))[-1]
    assert np.count_nonzero(overlay.labels) < 0.35 * len(true)


def test_a_label_needs_the_confidence(tmp_path: Path) -> None:
    files = written(tmp_path, [observation(0, -10.0, probability=0.7)])
    one = propagated(files, replace(PLAIN, confidence=0.71))[0]
    assert not one.labels.any()
    assert propagated(files, replace(PLAIN, confidence=0.69))[0].labels.any()


def test_agreeing_scans_make_a_map_surer_than_each_of_them(tmp_path: Path) -> None:
    scans = [observation(k, -10.0, probability=0.7) for k in range(3)]
    assert propagated(written(tmp_path, scans), PLAIN)[0].labels.any()


def test_what_lies_on_the_road_and_is_no_ground_is_unknown(tmp_path: Path) -> None:
    points, true = world()
    said = true.copy()
    beside_car = (abs(points[:, 0] + 6) < 0.5) & (points[:, 2] < 0.2)
    said[beside_car] = VEHICLE
    files = written(tmp_path, [observation(0, -10.0, said=said)])
    smeared = propagated(files, PLAIN)[0].labels
    assert (smeared[beside_car] == VEHICLE).all()
    for ground in (GroundFix.TILES, GroundFix.PLANE):
        mended = propagated(files, replace(PLAIN, ground=ground))[0].labels
        assert not mended[beside_car].any()
        assert np.count_nonzero(mended != smeared) == np.count_nonzero(beside_car)


def test_sky_outvotes_in_the_map_and_labels_no_return(tmp_path: Path) -> None:
    points, true = world()
    said = np.where(points[:, 2] > 2.5, SKY, true)
    one = propagated(written(tmp_path, [observation(0, -10.0, said=said)]), PLAIN)[0]
    assert SKY not in one.labels
    assert {ROAD, BUILDING} <= set(one.labels.tolist())


def test_points_without_a_return_and_the_vehicle_itself_have_no_label(tmp_path: Path) -> None:
    one = observation(0, -10.0)
    points = one.points.copy()
    points[:5] = 0
    files = written(tmp_path, [replace(one, points=points)])
    labeled = propagated(files, replace(PLAIN, min_range_m=3.0))[0]
    near = np.linalg.norm(points, axis=1) < 3.0
    assert not labeled.labels[near].any()
    assert not labeled.returns[near].any()
    assert labeled.labels[~near].any()


def test_a_label_of_what_moves_holds_near_the_time_it_was_seen(tmp_path: Path) -> None:
    person = (spot(0.0, 0.0, 1.0), np.full(3, PERSON))
    scans = [observation(k, -4.0, extra=person if k < 2 else None) for k in range(6)]
    # Later something else is there, of which no camera says anything: it is behind the sensor.
    ghost = (spot(0.0, 0.0, 1.0), np.full(3, BUILDING))
    scans += [observation(6, 4.0, extra=ghost)]
    files = written(tmp_path, scans)
    smeared = propagated(files, PLAIN)
    assert (smeared[-1].labels[-3:] == PERSON).all()
    limited = propagated(files, replace(PLAIN, dynamic_within=2))
    assert (limited[0].labels[-3:] == PERSON).all()
    assert not limited[-1].labels[-3:].any()
    assert (limited[-1].labels == BUILDING).any()  # what stands still has no limit
    assert (propagated(files, replace(PLAIN, dynamic_within=5))[-1].labels[-3:] == PERSON).all()


def test_a_dynamic_window_sees_what_the_whole_map_does_not(tmp_path: Path) -> None:
    """A voxel that a person passed is road or air for the flight, and a person for a moment."""
    place = spot(0.0, 0.0, 1.0)
    scans = [
        observation(k, -4.0, extra=(place, np.full(3, PERSON if k == 3 else BUILDING)))
        for k in range(12)
    ]
    files = written(tmp_path, scans)
    assert (propagated(files, PLAIN)[3].labels[-3:] == BUILDING).all()
    windowed = propagated(files, replace(PLAIN, dynamic_window=0))
    assert (windowed[3].labels[-3:] == PERSON).all()
    assert [set(one.labels[-3:].tolist()) for one in windowed[4:]] == [{BUILDING}] * 8
    # Two scans to each side outvote the one that saw the person.
    assert (propagated(files, replace(PLAIN, dynamic_window=2))[3].labels[-3:] == BUILDING).all()


def test_without_a_window_near_in_time_a_moving_label_of_the_map_is_dropped(
    tmp_path: Path,
) -> None:
    person = (spot(0.0, 0.0, 1.0), np.full(3, PERSON))
    ghost = (spot(0.0, 0.0, 1.0), np.full(3, BUILDING))
    scans = [observation(k, -4.0, extra=person) for k in range(3)]
    scans += [observation(3 + k, 4.0, extra=ghost) for k in range(6)]
    windowed = propagated(written(tmp_path, scans), replace(PLAIN, dynamic_window=2))
    assert (windowed[2].labels[-3:] == PERSON).all()
    assert not windowed[-1].labels[-3:].any()


def test_every_scan_is_labeled_once_in_order_with_any_window(tmp_path: Path) -> None:
    files = written(tmp_path, [observation(k, -4.0) for k in range(4)])
    for choice in (PLAIN, replace(PLAIN, dynamic_window=9), replace(PLAIN, dynamic_within=2)):
        stamps = [one.observation.stamp for one in propagated(files, choice)]
        assert stamps == [k * 100_000_000 for k in range(4)]


def test_what_was_made_degraded_can_be_left_out_of_map_and_labels(tmp_path: Path) -> None:
    _, true = world()
    wrong = np.full_like(true, PERSON)
    scans = [observation(0, -4.0)] + [
        observation(k, -4.0, said=wrong, degraded=True) for k in (1, 2, 3)
    ]
    files = written(tmp_path, scans)
    assert PERSON in propagated(files, PLAIN)[0].labels
    sound = propagated(files, replace(PLAIN, sound_only=True))
    assert len(sound) == 1
    assert PERSON not in sound[0].labels
    with pytest.raises(DataError, match="none of the 3 scans was made on sound devices"):
        build_map(files[1:], replace(PLAIN, sound_only=True))


def test_the_fused_map_has_the_lidar_networks_mistakes(tmp_path: Path) -> None:
    _, true = world()
    wrong = np.where(true == ROAD, VEHICLE, true)
    files = written(tmp_path, [observation(0, -10.0, fused=wrong)])
    fused = propagated(files, replace(PLAIN, teacher=Teacher.FUSED_MAP))[0]
    assert (fused.labels == VEHICLE).sum() == (true == ROAD).sum()
    without = written(tmp_path / "b", [observation(0, -10.0)])
    with pytest.raises(DataError, match="no evidence of a LiDAR network"):
        build_map(without, replace(PLAIN, teacher=Teacher.FUSED_MAP))


def test_a_scan_without_a_pose_is_in_no_map_and_gets_no_label(tmp_path: Path) -> None:
    lost = replace(observation(1, -10.0), map_from_sensor=None)
    files = written(tmp_path, [observation(0, -10.0), lost])
    first, second = propagated(files, PLAIN)
    assert first.labels.any()
    assert not second.labels.any()
    with pytest.raises(DataError, match="none of the 1 scans has a pose"):
        build_map(files[1:], PLAIN)


def test_cameras_that_say_nothing_are_told_with_the_way_out(tmp_path: Path) -> None:
    silent = observation(0, 40.0)  # the street lies behind the sensor
    assert len(silent.camera.index) == 0
    with pytest.raises(DataError, match=r"said nothing of any point; .*tolerance_ms"):
        build_map(written(tmp_path, [silent]), PLAIN)
