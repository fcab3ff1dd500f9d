from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from stages.kernels.anchors import SMALL_OBJECTS, multiscale_anchors  # noqa: E402
from tools.train.blocks import parameters_of, scaled  # noqa: E402
from tools.train.center_net import CenterNet  # noqa: E402
from tools.train.deeplab import DeepLab  # noqa: E402
from tools.train.mobiledet import MobileDet  # noqa: E402
from tools.train.pyramid_segmenter import PyramidSegmenter  # noqa: E402
from tools.train.residual_backbone import ResidualBackbone  # noqa: E402
from tools.train.salsanext import SalsaNext  # noqa: E402
from tools.train.ssd import FORMS, Ssd  # noqa: E402


@pytest.mark.parametrize(("classes", "parameters"), [(20, 6_711_572), (15, 6_711_407)])
def test_salsanext_has_as_many_parameters_as_the_published_one(
    classes: int, parameters: int
) -> None:
    assert parameters_of(SalsaNext(classes)) == parameters


def test_salsanext_answers_every_cell_at_any_width() -> None:
    network = SalsaNext(16, width=0.25).eval()
    assert network(torch.zeros(1, 5, 16, 32)).shape == (1, 16, 16, 32)


@pytest.mark.parametrize("backbone", [MobileDet(1, 0.5), ResidualBackbone(1)])
def test_a_backbone_gives_features_at_strides_4_to_32(
    backbone: MobileDet | ResidualBackbone,
) -> None:
    features = backbone.eval()(torch.zeros(1, 1, 64, 96))
    assert [one.shape[2:] for one in features] == [(16, 24), (8, 12), (4, 6), (2, 3)]
    assert tuple(one.shape[1] for one in features) == backbone.widths


def test_mobiledet_at_width_1_has_the_published_channels() -> None:
    assert MobileDet(3).widths == (16, 40, 96, 384)


def test_channels_are_rounded_to_eights_and_never_vanish() -> None:
    assert [scaled(n, 0.5) for n in (8, 16, 40, 72)] == [8, 8, 24, 40]


def test_a_size_that_does_not_divide_by_32_still_gives_cells_of_4_pixels() -> None:
    network = CenterNet(ResidualBackbone(3), 3).eval()
    outputs = network(torch.zeros(1, 3, 48, 80))  # 848 x 480 is 26.5 times 32
    assert {name: tuple(one.shape[1:]) for name, one in outputs.items()} == {
        "heat": (3, 12, 20),
        "size": (2, 12, 20),
        "offset": (2, 12, 20),
    }


def test_an_ssd_has_a_row_for_each_anchor_of_its_head() -> None:
    network = Ssd(ResidualBackbone(1), 3).eval()
    outputs = network(torch.zeros(1, 1, 64, 96))
    anchors = multiscale_anchors(*SMALL_OBJECTS, (96, 64))
    assert outputs["boxes"].shape == (1, len(anchors), 4)
    assert outputs["scores"].shape == (1, len(anchors), 3)


def test_rows_of_an_ssd_follow_levels_rows_columns_and_forms() -> None:
    network = Ssd(ResidualBackbone(1), 1).eval()
    for level, predictor in enumerate(network.scores):
        torch.nn.init.zeros_(predictor.weight)
        predictor.bias.data = 10.0 * level + torch.arange(FORMS)
    said = network(torch.zeros(1, 1, 32, 32))["scores"][0, :, 0].detach().numpy()
    cells = [64, 16, 4, 1]
    wanted = [np.tile(10.0 * level + np.arange(3), count) for level, count in enumerate(cells)]
    assert np.array_equal(said, np.concatenate(wanted))


@pytest.mark.parametrize(("stride", "cells"), [(8, (7, 13)), (16, (4, 7))])
def test_deeplab_aligns_its_corners_with_those_of_the_image(
    stride: int, cells: tuple[int, int]
) -> None:
    network = DeepLab(16, width=0.35, stride=stride, pyramid=16).eval()
    scores = network(torch.zeros(1, 3, 49, 97))
    assert scores.shape == (1, 16, *cells)
    assert ((cells[0] - 1) * stride, (cells[1] - 1) * stride) == (48, 96)


@pytest.mark.parametrize(("stride", "cells"), [(4, (13, 25)), (8, (7, 13)), (16, (4, 7))])
def test_a_pyramid_segmenter_aligns_its_corners_with_those_of_the_image(
    stride: int, cells: tuple[int, int]
) -> None:
    network = PyramidSegmenter(ResidualBackbone(3), 16, stride=stride).eval()
    assert network(torch.zeros(1, 3, 49, 97)).shape == (1, 16, *cells)
    assert ((cells[0] - 1) * stride, (cells[1] - 1) * stride) == (48, 96)


def test_the_published_mobilenet_differs_from_the_minimalistic_one() -> None:
    published, small = (DeepLab(16, minimalistic=flag) for flag in (False, True))
    assert parameters_of(published) > 2 * parameters_of(small)
    assert any(isinstance(one, torch.nn.Hardswish) for one in published.modules())
    assert not any(isinstance(one, torch.nn.Hardswish) for one in small.modules())
