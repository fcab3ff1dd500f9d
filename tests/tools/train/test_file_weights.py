"""A training that begins with the weights of a file: the network answers as the file does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from pipeline.errors import DataError, ModelError  # noqa: E402
from tools.train.beginning import begin_with  # noqa: E402
from tools.train.center_net import CenterNet  # noqa: E402
from tools.train.export import Exportable, write_onnx, write_openvino  # noqa: E402
from tools.train.file_weights import weights_of_file  # noqa: E402
from tools.train.mobiledet import MobileDet  # noqa: E402
from tools.train.pyramid_segmenter import PyramidSegmenter  # noqa: E402
from tools.train.residual_backbone import ResidualBackbone  # noqa: E402
from tools.train.salsanext import SalsaNext  # noqa: E402
from tools.train.ssd import Ssd  # noqa: E402

#: Weights of a file have 16 bits.
CLOSE = 0.02


def center_net() -> torch.nn.Module:
    return CenterNet(ResidualBackbone.slim(1), 3)


def mobile() -> torch.nn.Module:
    return CenterNet(MobileDet(1, 0.25), 2)


def segmenter() -> torch.nn.Module:
    return PyramidSegmenter(ResidualBackbone.slim(1), 4)


def salsanext() -> torch.nn.Module:
    return SalsaNext(4, channels=1, width=0.25)


def lived_in(network: torch.nn.Module) -> torch.nn.Module:
    """As after a training: no normalization is as it was born."""
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.3, 0.3)
            torch.nn.init.uniform_(module.running_mean, -0.3, 0.3)
            torch.nn.init.uniform_(module.running_var, 0.5, 2.0)
    return network


def file_of(network: torch.nn.Module, side: int, folder: Path) -> Path:
    names = getattr(network, "output_names", ("scores",))
    model = Exportable("net", network.eval(), (1, side, side), names)
    return write_openvino(model, write_onnx(model, folder), folder)


def begin_with_file(network: torch.nn.Module, file: Path, inputs: torch.Tensor) -> bool:
    return begin_with(network, weights_of_file(network, file, inputs), file)


def answers(network: torch.nn.Module, inputs: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        found = network(inputs)
    return (
        torch.cat([one.flatten(1) for one in found.values()], 1)
        if isinstance(found, dict)
        else found
    )


@pytest.mark.parametrize(
    ("make", "side"), [(center_net, 64), (mobile, 64), (segmenter, 65), (salsanext, 64)]
)
def test_a_network_begins_where_the_file_ended(
    make: Callable[[], torch.nn.Module], side: int, tmp_path: Path
) -> None:
    torch.manual_seed(3)
    trained = lived_in(make())
    file = file_of(trained, side, tmp_path)
    inputs = torch.randn(2, 1, side, side)
    fresh = make()
    assert begin_with_file(fresh, file, inputs)
    wanted = answers(trained.eval(), inputs)
    scale = wanted.std()
    assert (answers(fresh.eval(), inputs) - wanted).abs().max() < CLOSE * scale
    for module in fresh.modules():  # what is dropped at random is no part of the question
        if isinstance(module, torch.nn.Dropout2d | torch.nn.Dropout):
            module.p = 0.0
    # Its normalizations have measured: learning goes on from what the file answers.
    assert (answers(fresh.train(), inputs) - wanted).abs().max() < 5 * CLOSE * scale


def test_a_detector_begins_with_the_backbone_of_a_segmenters_file(tmp_path: Path) -> None:
    torch.manual_seed(4)
    trained = lived_in(segmenter())
    detector = Ssd(ResidualBackbone.slim(1), 2)
    inputs = torch.randn(2, 1, 64, 64)
    heads = {name: one.clone() for name, one in detector.head.state_dict().items()}
    assert not begin_with_file(detector, file_of(trained, 65, tmp_path), inputs)
    with torch.no_grad():
        mine = detector.eval().pyramid(detector.backbone(inputs))
        theirs = trained.eval().pyramid(trained.backbone(inputs))
    for level, wanted in zip(mine, theirs, strict=True):
        assert (level - wanted).abs().max() < CLOSE * wanted.std()
    assert all(torch.equal(one, heads[name]) for name, one in detector.head.state_dict().items())


def test_a_file_of_another_network_and_no_network_are_refused(tmp_path: Path) -> None:
    file = file_of(lived_in(center_net()), 64, tmp_path)
    before = (other := SalsaNext(4, channels=1, width=0.25)).state_dict()
    kept = {name: one.clone() for name, one in before.items()}
    with pytest.raises(DataError, match="neither the network nor its backbone"):
        begin_with_file(other, file, torch.randn(1, 1, 64, 64))
    assert all(torch.equal(one, kept[name]) for name, one in other.state_dict().items())
    broken = tmp_path / "broken.xml"
    broken.write_text("<net>")
    with pytest.raises(ModelError, match=r"broken\.xml: cannot be read"):
        begin_with_file(other, broken, torch.randn(1, 1, 64, 64))
