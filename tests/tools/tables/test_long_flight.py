"""Fig 16: how a map grows over a flight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from judged_scans import BUILDING, ROAD, judged

from tools.tables.long_flight import mapped, plot_of, table_of
from tools.tables.world import JudgedScan


class World:
    """Five scans, 3 m apart, each of other voxels; the third has no pose."""

    def judged(self, flight: str) -> Iterator[JudgedScan]:
        assert flight == "long"
        scan = judged([ROAD, ROAD, BUILDING], [0, 1, 2], {0: ROAD, 1: ROAD, 2: BUILDING})
        for number in range(5):
            pose = np.eye(4)
            pose[0, 3] = 3.0 * number
            known = None if number == 2 else pose
            observation = replace(scan.observation, stamp=number, map_from_sensor=known)
            yield replace(scan, observation=observation)


def test_the_map_grows_with_the_way_flown() -> None:
    built, growth = mapped(World(), None)  # type: ignore[arg-type]
    assert [one.scans for one in growth] == [1, 2, 3, 4]
    assert [one.flown_m for one in growth] == pytest.approx([0, 3, 9, 12])
    assert growth[-1].voxels == built.used == len(built.snapshot().indices)
    assert [one.voxels for one in growth] == sorted(one.voxels for one in growth)
    assert growth[-1].map_bytes == built.nbytes
    assert growth[-1].process_bytes > built.nbytes


def test_the_table_has_the_first_and_the_last_scan_and_the_plot_both_lines() -> None:
    _, growth = mapped(World(), None)  # type: ignore[arg-type]
    lines = table_of(growth).splitlines()
    assert lines[2].startswith("| 0 | 1 | ")
    assert lines[5].startswith("| 12 | 4 | ")
    assert "MB more after the last scan" in lines[-1]
    assert plot_of(growth).count("<polyline") == 2
