"""Pictures, pixel by pixel where it matters."""

from __future__ import annotations

import cv2
import numpy as np

from stages.kernels.render import (
    PAPER,
    add_legend,
    blend_classes,
    draw_box,
    draw_points,
    encode_png,
    top_view,
)

COLORS = np.array([[0, 0, 0], [200, 0, 0], [0, 100, 0]], np.uint8)


def test_a_png_holds_the_rgb_image_it_was_made_of() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    back = cv2.imdecode(np.frombuffer(encode_png(image), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(back[..., ::-1], image)


def test_a_blend_mixes_class_colors_and_leaves_background_alone() -> None:
    image = np.full((1, 2, 3), 100, np.uint8)
    mixed = blend_classes(image, np.array([[0, 1]], np.uint8), COLORS, 0.5)
    assert mixed.tolist() == [[[100, 100, 100], [150, 50, 50]]]


def test_from_above_the_highest_point_of_a_cell_shows_and_north_is_up() -> None:
    positions = np.array([[0.1, 0.1, 2.0], [0.2, 0.2, 1.0], [0.9, 0.6, 0.0]], np.float32)
    picture = top_view(positions, np.array([1, 2, 2], np.uint8), COLORS, 0.5, 2)
    assert picture.shape == (4, 4, 3)
    assert (picture[2:, :2] == COLORS[1]).all()  # the lower left cell: (0, 0)
    assert (picture[:2, 2:] == COLORS[2]).all()  # the upper right one
    assert (picture[:2, :2] == PAPER).all()


def test_an_empty_map_is_a_small_empty_picture() -> None:
    picture = top_view(np.zeros((0, 3), np.float32), np.zeros(0, np.uint8), COLORS, 0.25, 2)
    assert (picture == PAPER).all()


def test_the_legend_shows_each_color_and_a_scale_bar_of_the_right_length() -> None:
    picture = np.full((50, 900, 3), PAPER, np.uint8)
    whole = add_legend(picture, [("building", (200, 0, 0)), ("road", (0, 100, 0))], 8.0)
    for color in COLORS[1:]:
        assert (whole == color).all(axis=-1).sum() == 29 * 17
    bar = (whole[50 + 16 + 16 + 8] == 40).all(axis=-1)
    assert bar[: 16 + 161].sum() == 161  # 20 m at 8 pixels each, both ends drawn


def test_points_and_boxes_beyond_the_border_are_clipped() -> None:
    image = np.zeros((10, 10, 3), np.uint8)
    draw_points(image, np.array([[0, 0], [9.4, 9.4]], np.float32), COLORS[1:], 1)
    assert (image[:2, :2] == COLORS[1]).all()
    assert (image[8:, 8:] == COLORS[2]).all()
    assert not image[3:7].any()
    draw_box(image, np.array([-5, -5, 50, 50], np.float32), "vehicle 0.9", (129, 0, 127))
