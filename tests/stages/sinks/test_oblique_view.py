"""The map from aside: cubes that hide what lies behind them, on a page with a legend."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.message import Message
from stages.kernels.render import PAPER, oblique_view
from stages.sinks.oblique_view import ObliqueView, draw_map_aside
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels

RED, BLUE = 0, 1
COLORS = np.array([[200, 0, 0], [0, 0, 200]], dtype=np.uint8)


def voxels(indices: np.ndarray, label: np.ndarray) -> SemanticVoxels:
    scores = np.zeros((len(label), 16), dtype=np.float32)
    scores[np.arange(len(label)), label] = 5.0
    positions = ((indices + 0.5) * 0.25).astype(np.float32)
    counts = np.ones(len(label), dtype=np.int32)
    return SemanticVoxels(0.25, indices.astype(np.int32), positions, scores, counts)


def area(picture: np.ndarray, channel: int) -> int:
    others = [c for c in range(3) if c != channel]
    return int(((picture[..., channel] > 0) & (picture[..., others] == 0).all(axis=-1)).sum())


def test_a_cube_shows_a_light_top_and_two_sides_of_which_the_right_is_darker() -> None:
    picture = oblique_view(np.zeros((1, 3), np.int32), np.array([RED], np.uint8), COLORS)
    shades = np.unique(picture[..., 0]).tolist()
    assert shades == [128, 164, 200]
    assert picture[0].max() == 200
    assert picture[-1, 0, 0] > picture[-1, -1, 0]


def test_a_wall_hides_what_lies_behind_it_and_not_what_lies_before() -> None:
    wall = np.array([[0, 0, z] for z in range(12)], dtype=np.int32)
    for place, hidden in (((3, 3, 0), True), ((-3, -3, 0), False)):
        indices = np.vstack([wall, [place]]).astype(np.int32)
        labels = np.array([RED] * 12 + [BLUE], dtype=np.uint8)
        for order in (slice(None), slice(None, None, -1)):  # whatever the order in the map
            picture = oblique_view(indices[order], labels[order], COLORS)
            assert (area(picture, 2) == 0) == hidden


def test_the_picture_leaves_out_the_sky_and_single_voxels_far_away(tmp_path: Path) -> None:
    taxonomy = load_taxonomy()
    ground = np.array([[x, y, 0] for x in range(40) for y in range(40)])
    label = np.full(len(ground), taxonomy.id("road"))
    alone = draw_map_aside(voxels(ground, label))
    far = np.vstack([ground, [[900, 0, 0], [0, 0, 50]]])
    more = np.append(label, [taxonomy.id("vehicle"), taxonomy.id("sky")])
    sink = ObliqueView(path=tmp_path / "map.png")
    sink.process(Message.at(0, voxels(far, more)))
    sink.close()
    drawn = cv2.imread(str(tmp_path / "map.png"))
    assert drawn is not None
    assert (drawn[..., ::-1] == alone).all()


def test_an_empty_map_is_an_empty_page() -> None:
    page = draw_map_aside(voxels(np.zeros((0, 3), int), np.zeros(0, int)))
    assert (page == PAPER).all()
