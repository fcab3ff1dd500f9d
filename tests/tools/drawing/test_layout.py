from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.drawing.layout import Layout, Link, arrange

GAP = 20.0


@st.composite
def graphs(draw: st.DrawFn) -> tuple[dict[str, float], list[Link]]:
    """Any graph without cycles: links go from earlier to later boxes."""
    heights = draw(st.lists(st.floats(20, 200), min_size=1, max_size=9))
    pairs = st.tuples(*[st.integers(0, len(heights) - 1)] * 2).filter(
        lambda pair: pair[0] < pair[1]
    )
    chosen = draw(st.lists(pairs, max_size=16)) if len(heights) > 1 else []
    links = [
        Link(str(a), str(b), draw(st.floats(0, heights[a])), draw(st.floats(0, heights[b])))
        for a, b in chosen
    ]
    return {str(i): height for i, height in enumerate(heights)}, links


@given(graphs())
def test_every_link_goes_to_the_right(graph: tuple[dict[str, float], list[Link]]) -> None:
    heights, links = graph
    layout = arrange(heights, links, GAP)
    for link, bends in zip(links, layout.bends, strict=True):
        assert layout.column[link.source] + len(bends) + 1 == layout.column[link.target]


@given(graphs())
def test_boxes_and_passing_links_of_a_column_keep_their_distance(
    graph: tuple[dict[str, float], list[Link]],
) -> None:
    heights, links = graph
    layout = arrange(heights, links, GAP)
    for column in range(max(layout.column.values()) + 1):
        spans = sorted(
            [
                (layout.top[name], layout.top[name] + height)
                for name, height in heights.items()
                if layout.column[name] == column
            ]
            + [
                (bends[column - layout.column[link.source] - 1],) * 2
                for link, bends in zip(links, layout.bends, strict=True)
                if layout.column[link.source] < column < layout.column[link.target]
            ]
        )
        for (_, upper_end), (lower_start, _) in itertools.pairwise(spans):
            assert lower_start - upper_end >= GAP - 1e-6


@given(graphs())
def test_the_same_graph_is_always_laid_out_alike(
    graph: tuple[dict[str, float], list[Link]],
) -> None:
    assert arrange(*graph, GAP) == arrange(*graph, GAP)


def test_a_chain_is_a_straight_line() -> None:
    layout = arrange({"a": 40.0, "b": 40.0}, [Link("a", "b", 10.0, 30.0)], GAP)
    assert layout.top["a"] + 10.0 == pytest.approx(layout.top["b"] + 30.0)


def test_two_chains_listed_crosswise_do_not_cross() -> None:
    heights = dict.fromkeys("abcd", 40.0)
    layout = arrange(heights, [Link("a", "d", 20, 20), Link("b", "c", 20, 20)], GAP)
    assert (layout.top["a"] < layout.top["b"]) == (layout.top["d"] < layout.top["c"])


def test_no_box_needs_no_room() -> None:
    assert arrange({}, [], GAP) == Layout({}, {}, [])
