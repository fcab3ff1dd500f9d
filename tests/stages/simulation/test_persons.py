"""Persons stay whole and on their feet."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.persons import PARTS, Build, limbs, riding, walking

BUILD = Build.draw(np.random.default_rng(3))


def corners_of(poses: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    parts = limbs(1, BUILD)
    moved = [
        np.concatenate(part.corners).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
        for part, pose in zip(parts, poses, strict=True)
    ]
    return np.concatenate(moved)


@pytest.mark.parametrize("phase", np.linspace(0, 2 * np.pi, 7))
def test_a_walking_person_has_a_foot_near_the_ground_and_the_head_on_top(phase: float) -> None:
    corners = corners_of(walking(BUILD, phase))
    assert -0.06 < corners[:, 2].min() < 0.08
    assert corners[:, 2].max() == pytest.approx(BUILD.height_m, abs=0.12)


def test_the_legs_swing_against_each_other() -> None:
    right, left = walking(BUILD, np.pi / 2)[[1, 5]]
    assert right[0, 2] * left[0, 2] < 0


@pytest.mark.parametrize("poses", [walking(BUILD, 1.0), riding(BUILD, 1.0)])
def test_the_limbs_hang_together(poses: np.ndarray) -> None:  # type: ignore[type-arg]
    assert len(poses) == PARTS
    h = BUILD.height_m / 1.75
    for upper, lower, length in ((1, 2, 0.45), (5, 6, 0.45), (3, 4, 0.29), (7, 8, 0.29)):
        end = poses[upper] @ np.array([0, 0, -length * h, 1])
        assert poses[lower][:3, 3] == pytest.approx(end[:3])


@pytest.mark.parametrize("phase", np.linspace(0, 2 * np.pi, 7))
def test_a_rider_has_the_knees_ahead_and_the_feet_where_the_pedals_turn(phase: float) -> None:
    poses = riding(BUILD, phase)
    h = BUILD.height_m / 1.75
    crank = np.array([-0.08 + 0.26, 0.29])  # of the bicycle, from under the saddle
    for shin in (2, 6):
        knee, foot = poses[shin][:3, 3], poses[shin] @ np.array([0, 0, -0.43 * h, 1])
        assert knee[0] > 0.25
        assert np.hypot(*(foot[[0, 2]] - crank)) < 0.32
