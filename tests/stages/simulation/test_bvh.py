"""The hierarchy holds every box once, under nodes that contain it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stages.simulation.bvh import LEAF, Bvh, build

coordinates = st.floats(-100, 100, width=32, allow_subnormal=False)


@given(arrays(np.float32, st.tuples(st.integers(1, 60), st.just(3)), elements=coordinates))
def test_every_item_stands_in_one_leaf_inside_the_boxes_above_it(
    lows: np.ndarray[tuple[int, int], np.dtype[np.float32]],
) -> None:
    highs = lows + np.float32(0.5)
    tree = build(lows, highs)
    seen: list[int] = []
    check(tree, 0, lows, highs, seen)
    assert sorted(seen) == list(range(len(lows)))


def check(tree: Bvh, node: int, lows: np.ndarray, highs: np.ndarray, seen: list[int]) -> list[int]:  # type: ignore[type-arg]
    """The items under a node; asserts that both its boxes contain their items."""
    both = []
    for side in range(2):
        child = int(tree.children[node, side])
        if child < 0:
            first, count = (-child - 1) >> 3, (-child - 1) & 7
            assert count <= LEAF
            items = tree.order[first : first + count].tolist()
            seen += items
        else:
            items = check(tree, child, lows, highs, seen)
        box = tree.boxes[node, 6 * side : 6 * side + 6]
        assert (lows[items] >= box[:3]).all()
        assert (highs[items] <= box[3:]).all()
        both += items
    return both
