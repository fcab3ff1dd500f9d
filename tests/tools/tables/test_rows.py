"""Rows of a table: filled once, kept, and judged by groups of classes."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from pipeline.errors import DataError
from tools.tables.rows import Rows, Verdict
from tools.tables.table import Line, Table

QUIET = Console(quiet=True)


def verdict(mean: float) -> Verdict:
    return Verdict(mean, {"road": mean, "person": None}, {"road": 10, "person": 0})


def test_a_row_is_filled_once_and_then_read(tmp_path: Path) -> None:
    calls: list[int] = []

    def fill() -> Verdict:
        calls.append(1)
        return verdict(40.0)

    first = Rows(tmp_path, {"steps": 3}, QUIET).filled("map", 0, fill)
    again = Rows(tmp_path, {"steps": 3}, QUIET).filled("map", 0, fill)
    assert calls == [1]
    assert first == again
    assert Rows(tmp_path, {"steps": 3}, QUIET).read("map", 1) is None


def test_rows_of_other_conditions_are_not_mixed(tmp_path: Path) -> None:
    Rows(tmp_path, {"steps": 3}, QUIET)
    with pytest.raises(DataError, match="rows of other conditions lie there"):
        Rows(tmp_path, {"steps": 4}, QUIET)


def test_a_row_that_was_stopped_is_not_there(tmp_path: Path) -> None:
    def stop() -> Verdict:
        raise KeyboardInterrupt

    rows = Rows(tmp_path, {}, QUIET)
    with pytest.raises(KeyboardInterrupt):
        rows.filled("map", 0, stop)
    assert rows.read("map", 0) is None


def test_classes_count_together_and_rare_ones_stay_out_of_the_mean() -> None:
    matrix = np.zeros((16, 16), np.int64)
    matrix[3, 3], matrix[4, 3] = 900, 100  # sidewalk taken for road: the same column
    matrix[13, 13], matrix[13, 3] = 50, 50
    matrix[5, 13] = 1  # a person
    matrix[2, 3] = 500  # a barrier is in no column: it is not judged
    judged = Verdict.of(matrix, "paper", min_points=0.01)
    assert judged.classes["road"] == pytest.approx(100 * 1000 / 1050)
    assert judged.classes["car"] == pytest.approx(100 * 50 / 101)
    assert judged.classes["person"] == 0
    assert judged.classes["bike"] is None
    assert judged.points["person"] == 1
    assert judged.mean == pytest.approx((100 * 1000 / 1050 + 100 * 50 / 101) / 2)
    strict = Verdict.of(matrix, "paper", min_points=1)
    assert strict.mean == pytest.approx((100 * 1000 / 1050 + 100 * 50 / 101) / 3)


def test_a_table_compares_the_order_with_the_papers() -> None:
    table = Table(
        "t",
        [
            Line("worse", [verdict(10), verdict(14)], paper=20.0),
            Line("better", [verdict(30)], paper=60.0),
            Line("best", [verdict(20)], paper=70.0, note="with a reason"),
            Line("control", [verdict(12)]),
            Line("later", [], paper=90.0),
        ],
        ["one place"],
    )
    assert sorted(table.order()) == [
        ("best", "better", False), ("best", "worse", True), ("better", "worse", True),
    ]  # fmt: skip
    told = table.told()
    assert told["rows"][0]["mean"] == 12
    assert told["rows"][0]["spread"] == 4
    assert told["rows"][4]["mean"] is None
    page = table.markdown()
    assert "| worse | 12.0 | - | **12.0** | 4.0 (2) | 20.0 |" in page
    assert "- not run: later" in page
    assert "- of the 3 pairs that the paper sets apart, 2 hold here" in page
    assert "- not here: best > better" in page
    assert "- best: with a reason" in page
    table.show(Console(quiet=True))


@pytest.mark.parametrize(("columns", "classes"), [(70, False), (80, True)])
def test_a_narrow_terminal_gets_a_table_without_the_classes(columns: int, classes: bool) -> None:
    title = "source + views + camera-only map, no intensity"
    written = StringIO()
    console = Console(file=written, width=columns)
    Table("t", [Line(title, [verdict(30)])]).show(console)
    shown = written.getvalue()
    assert title in shown  # on one line
    assert ("person" in shown) == classes
    assert ("- classes: in the .md file" in shown) == (not classes)


def test_a_table_that_the_paper_has_not_has_no_column_of_it() -> None:
    table = Table("t", [Line("a", [verdict(10)])], measure="recall in %", value="never in view")
    head = table.markdown().splitlines()[2]
    assert head.startswith("| recall in % |")
    assert head.endswith("| never in view | spread |")
    known = Table("t", [Line("a", [verdict(10)], paper=20.0)])
    assert known.markdown().splitlines()[2].endswith("| mean | spread | paper |")
