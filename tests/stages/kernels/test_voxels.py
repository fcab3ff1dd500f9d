"""Keys and the table that finds them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stages.kernels.horizon import find, voxel_keys
from stages.kernels.voxels import REACH, index_keys, unpack


def keys_of(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    columns = np.ascontiguousarray(points.T, np.float32)
    keys, _ = voxel_keys(*columns, np.ones(len(points), bool), pose, 1.0)
    return np.asarray(keys)


@given(st.tuples(*[st.integers(-REACH + 1, REACH - 2)] * 3))
def test_a_key_unpacks_to_its_voxel(index: tuple[int, int, int]) -> None:
    pose = np.eye(4)
    pose[:3, 3] = np.array(index) + 0.5
    assert tuple(unpack(keys_of(np.zeros((1, 3)), pose))[0]) == index


def test_an_index_finds_every_key_and_no_other() -> None:
    rng = np.random.default_rng(3)
    keys = np.unique(keys_of(rng.normal(0, 40, (4_000, 3)), np.eye(4)))
    held, others = keys[::2].copy(), keys[1::2].copy()
    table = np.zeros(1 << 13, np.int32)
    index_keys(held, len(held), table)
    slots, missing = find(held, table, held)
    np.testing.assert_array_equal(slots, np.arange(len(held)))
    assert missing == 0
    slots, missing = find(others, table, held)
    assert missing == len(others)
    assert (slots == -1).all()
