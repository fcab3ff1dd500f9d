"""Fig 17: the moment that is shown."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from judged_scans import PERSON, ROAD, judged

from tools.tables.disaster import busiest
from tools.tables.world import JudgedScan


class World:
    """Persons in view: one with two returns, then two, then three of whom two are out of view."""

    def judged(self, flight: str) -> Iterator[JudgedScan]:
        assert flight == "disaster"
        yield judged([PERSON, PERSON, ROAD], [0, 1, 2], {}, [4, 4, 1])
        yield judged([PERSON, PERSON, ROAD], [0, 1, 2], {}, [4, 5, 1])
        yield judged([PERSON, PERSON, PERSON], [0], {}, [4, 5, 6])


def test_the_scan_with_most_persons_in_view_is_shown() -> None:
    assert busiest(World()).things.tolist() == [4, 5, 1]  # type: ignore[arg-type]
