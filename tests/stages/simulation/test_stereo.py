"""Depth errs as a stereo camera's does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from stages.simulation.stereo import stereo_depth

FOCAL, BASELINE = 424.0, 0.095


def measured(depth: NDArray[np.float32], noise_px: float = 0.05) -> NDArray[np.float64]:
    counts = np.empty(depth.shape, dtype=np.uint16)
    stereo_depth(depth, FOCAL, BASELINE, noise_px, 1 / 32, 0.5, 20.0, 0.001, 3, counts)
    return counts * 0.001


@pytest.mark.parametrize("z", [2.0, 6.0, 12.0])
def test_noise_grows_with_the_square_of_the_distance(z: float) -> None:
    depth = np.full((200, 200), z, dtype=np.float32)
    error = measured(depth)[:, :150] - z
    step = z * z / (FOCAL * BASELINE) / 32
    expected = np.hypot(0.05 * z * z / (FOCAL * BASELINE), step / np.sqrt(12))
    assert error.std() == pytest.approx(expected, rel=0.12)
    assert abs(error.mean()) < 0.25 * error.std()


def test_there_is_no_depth_of_the_sky_nor_out_of_range() -> None:
    depth = np.array([[0.0, 0.3, 25.0, 5.0]], dtype=np.float32)
    assert (measured(depth, 0.0)[0] > 0).tolist() == [False, False, False, True]


def test_the_right_imager_does_not_see_behind_the_left_edge_of_what_is_near() -> None:
    depth = np.full((1, 200), 10.0, dtype=np.float32)
    depth[0, 100:150] = 2.0
    seen = measured(depth, 0.0)[0] > 0
    shadow = FOCAL * BASELINE * (1 / 2.0 - 1 / 10.0)
    hidden = np.flatnonzero(~seen)
    assert hidden.max() == 99
    assert len(hidden) == pytest.approx(shadow, abs=1.5)
    assert (np.diff(hidden) == 1).all()
