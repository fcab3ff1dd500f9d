from __future__ import annotations

from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.drawing.plot import Line, bar_plot, line_plot, ticks

SVG = "{http://www.w3.org/2000/svg}"


def drawn(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text)


def corners(element: ElementTree.Element) -> list[tuple[float, float]]:
    pairs = (pair.split(",") for pair in element.get("points", "").split())
    return [(float(x), float(y)) for x, y in pairs]


@given(st.floats(1e-9, 1e12))
def test_an_axis_ends_no_lower_than_what_it_shows_and_has_few_round_ticks(most: float) -> None:
    step, end = ticks(most)
    assert end >= most * (1 - 1e-9)
    assert end <= most + step
    assert 1 <= round(end / step) <= 6
    assert float(f"{step:.0e}") == pytest.approx(step)


def test_an_axis_of_nothing_is_an_axis() -> None:
    assert ticks(0.0) == (1.0, 1.0)


def test_lines_lie_where_their_numbers_say() -> None:
    picture = drawn(
        line_plot([Line("a", [(0, 0), (5, 10), (10, 20)]), Line("b", [(10, 10)])], "x", "y")
    )
    a, b = (corners(line) for line in picture.iter(f"{SVG}polyline"))
    assert a[1] == pytest.approx(((a[0][0] + a[2][0]) / 2, (a[0][1] + a[2][1]) / 2))
    assert a[0][1] > a[2][1]  # up is less
    assert b[0] == pytest.approx((a[2][0], a[1][1]))


def test_the_second_device_is_dashed_and_names_are_escaped() -> None:
    picture = drawn(line_plot([Line("net <&>", [(1, 1)], dashed=True)], "x", "y"))
    assert next(picture.iter(f"{SVG}polyline")).get("stroke-dasharray")
    assert "net <&>" in {text.text for text in picture.iter(f"{SVG}text")}


def test_the_parts_of_a_bar_touch_and_add_up() -> None:
    picture = drawn(bar_plot([("a", {"prepare": 1.0, "infer": 3.0}), ("b", {"infer": 8.0})], "ms"))
    bars = [bar for bar in picture.iter(f"{SVG}rect") if len(bar)]
    prepare, infer, other = bars
    assert float(infer.get("x", 0)) == pytest.approx(
        float(prepare.get("x", 0)) + float(prepare.get("width", 0))
    )
    both = float(prepare.get("width", 0)) + float(infer.get("width", 0))
    assert both == pytest.approx(float(other.get("width", 0)) / 2, abs=0.02)
    assert infer.get("fill") == other.get("fill") != prepare.get("fill")
    assert {"4.0", "8.0"} <= {text.text for text in picture.iter(f"{SVG}text")}


def test_a_picture_without_anything_is_a_picture() -> None:
    drawn(line_plot([], "x", "y"))
    drawn(bar_plot([], "x"))


def test_a_part_has_the_same_color_in_every_plot_that_names_its_parts_in_one_order() -> None:
    def colors(row: dict[str, float]) -> dict[str, str]:
        picture = drawn(bar_plot([("a", row)], "ms", order=("prepare", "infer", "finish")))
        bars = [bar for bar in picture.iter(f"{SVG}rect") if bar.find(f"{SVG}title") is not None]
        return {
            (bar.findtext(f"{SVG}title") or "").partition(":")[0]: bar.get("fill", "")
            for bar in bars
        }

    whole = colors({"finish": 1.0, "infer": 1.0, "prepare": 1.0})
    assert len(set(whole.values())) == 3
    assert colors({"finish": 1.0}) == {"finish": whole["finish"]}
