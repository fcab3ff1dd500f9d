"""What pictures of a map leave out: trails of what has moved on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.message import Message
from stages.sinks.drawn_map import DrawnMap, classes_of
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels

ROAD, PERSON, VEHICLE = (load_taxonomy().id(name) for name in ("road", "person", "vehicle"))


def voxels(entries: list[tuple[float, int]]) -> SemanticVoxels:
    """Voxels along x, m, each with its class."""
    positions = np.array([[x, 0.1, 0.1] for x, _ in entries], dtype=np.float32).reshape(-1, 3)
    scores = np.zeros((len(entries), 16), dtype=np.float32)
    scores[np.arange(len(entries)), [label for _, label in entries]] = 5.0
    indices = np.floor(positions / 0.25).astype(np.int32)
    return SemanticVoxels(0.25, indices, positions, scores, np.ones(len(entries), np.int32))


class Kept(DrawnMap):
    """Keeps what it would draw."""

    drawn: SemanticVoxels

    def write(self, path: Path, voxels: SemanticVoxels) -> None:
        self.drawn = voxels


def drawn(everything: SemanticVoxels, recent: SemanticVoxels | None) -> list[tuple[float, int]]:
    sink = Kept(path=Path("never_written.png"))
    sink.process(Message.at(0, everything), None if recent is None else Message.at(0, recent))
    sink.close()
    places = sink.drawn.positions[:, 0].astype(float).round(3).tolist()
    return list(zip(places, classes_of(sink.drawn).tolist(), strict=True))


#: A road, a parked car, and a person who came from 20 to 24 m.
SEEN = [(x, ROAD) for x in range(0, 40, 2)] + [(3.0, VEHICLE), (3.25, VEHICLE), (3.5, VEHICLE)]
WALKED = [(20 + 0.25 * k, PERSON) for k in range(17)]


def test_what_walked_by_is_drawn_where_it_is_now_and_a_parked_car_whole() -> None:
    now = voxels([(3.25, VEHICLE), (24.0, PERSON), (8.0, ROAD)])
    kept = drawn(voxels(SEEN + WALKED), now)
    assert [x for x, label in kept if label == VEHICLE] == [3.0, 3.25, 3.5]
    assert [x for x, label in kept if label == PERSON] == [23.25, 23.5, 23.75, 24.0]
    assert sum(label == ROAD for _, label in kept) == 20


def test_without_anything_that_moves_now_none_is_drawn() -> None:
    assert {label for _, label in drawn(voxels(SEEN + WALKED), voxels([]))} == {ROAD}


@pytest.mark.parametrize("entries", [SEEN + WALKED, []])
def test_without_a_recent_map_all_is_drawn(entries: list[tuple[float, int]]) -> None:
    assert len(drawn(voxels(entries), None)) == len(entries)
