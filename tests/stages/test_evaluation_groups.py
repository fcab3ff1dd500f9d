"""Groupings of classes, shipped and of the user."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import DataError
from stages.evaluation_groups import load_groups


def test_the_paper_s_columns_ship_in_two_readings() -> None:
    assert load_groups("paper")["road"] == [3, 4]
    assert list(load_groups("paper")) == list(load_groups("paper_wide"))
    assert load_groups("paper_wide")["object"] == [14, 2, 10]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: [car]", "'car' is no class that can be judged .classes: building"),
        ("a: [background]", "'background' is no class"),
        ("a: [road]\nb: [road]", "b: 'road' is in two groups"),
        ("[road]", "needs a list of classes for each group"),
        ("a: road", "needs a list of classes for each group"),
        ("a: [", "not YAML"),
    ],
)
def test_a_wrong_grouping_says_what_and_where(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "groups.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=f"groups.yaml.*{what}"):
        load_groups(str(path))
    path.write_text("street: [road, sidewalk]")
    assert load_groups(str(path)) == {"street": [3, 4]}
    with pytest.raises(DataError, match="no grouping 'papre': neither a file nor one of paper"):
        load_groups("papre")
