from __future__ import annotations

import numpy as np

from stages.kernels.network_input import fitted, gamma_table, in_color_order, placement


def marked(width: int, height: int) -> np.ndarray:  # type: ignore[type-arg]
    """A black image with one white 20 x 20 square from (40, 20)."""
    image = np.zeros((height, width, 3), dtype=np.uint8)
    image[20:40, 40:60] = 255
    return image


def square(picture: np.ndarray) -> list[float]:  # type: ignore[type-arg]
    """Pixel edges x0 y0 x1 y1 of what is white."""
    v, u = np.nonzero(picture[..., 0] > 200)
    return [float(u.min()), float(v.min()), float(u.max() + 1), float(v.max() + 1)]


def test_the_placement_says_where_the_image_went() -> None:
    for letterbox in (False, True):
        picture = fitted(marked(120, 60), (240, 240), letterbox=letterbox)
        assert picture.shape == (240, 240, 3)
        gain_x, gain_y, shift_x, shift_y = placement((120, 60), (240, 240), letterbox=letterbox)
        expected = [40 * gain_x, 20 * gain_y, 60 * gain_x, 40 * gain_y]
        shifts = [shift_x, shift_y, shift_x, shift_y]
        np.testing.assert_allclose(square(picture), np.add(expected, shifts), atol=1)


def test_a_letterbox_keeps_the_aspect_and_is_gray_around() -> None:
    picture = fitted(marked(120, 60), (240, 240), letterbox=True)
    assert placement((120, 60), (240, 240), letterbox=True).tolist() == [2, 2, 0, 60]
    assert (picture[:60] == 114).all()
    assert (picture[180:] == 114).all()


def test_an_image_of_the_right_size_is_not_copied() -> None:
    image = marked(120, 60)
    assert fitted(image, (120, 60)) is image


def test_shrinking_averages_instead_of_skipping_pixels() -> None:
    stripes = np.zeros((64, 64, 3), dtype=np.uint8)
    stripes[:, ::2] = 255
    picture = fitted(stripes, (16, 16))
    assert np.abs(picture.astype(int) - 128).max() <= 1


def test_colors_come_in_the_order_the_network_wants() -> None:
    image = np.zeros((1, 1, 3), dtype=np.uint8)
    image[0, 0] = (10, 20, 30)
    assert in_color_order(image, "rgb")[0, 0].tolist() == [10, 20, 30]
    assert in_color_order(image, "bgr")[0, 0].tolist() == [30, 20, 10]
    assert in_color_order(image, "gray").shape == (1, 1, 1)
    gray = np.full((1, 1), 7, dtype=np.uint8)
    assert in_color_order(gray, "gray")[0, 0].tolist() == [7]
    assert in_color_order(gray, "rgb")[0, 0].tolist() == [7, 7, 7]
    assert np.shares_memory(in_color_order(image, "bgr"), image)


def test_a_gamma_below_one_opens_the_shadows_and_keeps_the_ends() -> None:
    table = gamma_table(0.6)
    assert (table[0], table[255]) == (0, 255)
    assert table[64] == round(255 * (64 / 255) ** 0.6)
    assert (np.diff(table.astype(int)) >= 0).all()
