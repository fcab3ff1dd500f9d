from __future__ import annotations

import csv
import platform
import signal
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from driving import arrive  # noqa: E402
from rich.console import Console  # noqa: E402

from pipeline.errors import DataError  # noqa: E402
from tools.train.beginning import begin_with, weights_of_training  # noqa: E402
from tools.train.center_net import CenterNet  # noqa: E402
from tools.train.loop import Interrupted, Training  # noqa: E402
from tools.train.mobiledet import MobileDet  # noqa: E402
from tools.train.precision import has_bfloat16  # noqa: E402
from tools.train.pyramid_segmenter import PyramidSegmenter  # noqa: E402
from tools.train.residual_backbone import ResidualBackbone  # noqa: E402
from tools.train.salsanext import SalsaNext  # noqa: E402
from tools.train.task import Settings  # noqa: E402

STEPS = 25
QUIET = Console(quiet=True)


class Line:
    """Learns to double; interrupted or poisoned at a step, where asked."""

    def __init__(self, stop_at: int | None = None, poison: bool = False) -> None:
        torch.manual_seed(7)
        self.network = torch.nn.Sequential(torch.nn.Conv2d(1, 4, 3, padding=1), torch.nn.Dropout())
        self.network.append(torch.nn.BatchNorm2d(4))
        self.network.append(torch.nn.Conv2d(4, 1, 1))
        self._stop_at = stop_at
        self._poison = poison
        self._learned = 0

    def batch(self, random: np.random.Generator) -> dict[str, torch.Tensor]:
        pixels = torch.from_numpy(random.standard_normal((2, 1, 6, 6)).astype(np.float32))
        return {"input": pixels, "wanted": 2 * pixels}

    def loss(
        self, outputs: torch.Tensor, batch: Mapping[str, torch.Tensor]
    ) -> dict[str, torch.Tensor]:
        if self._learned == self._stop_at:
            arrive(signal.SIGINT)  # Ctrl-C in the middle of a step
        self._learned += 1
        error = (outputs.float() - batch["wanted"]).square().mean()
        return {"error": error * (float("nan") if self._poison else 1)}


def settings(**changes: object) -> Settings:
    return Settings(**({"steps": STEPS, "rate": 0.02} | changes))  # type: ignore[arg-type]


def weights(network: torch.nn.Module) -> list[np.ndarray]:
    return [one.numpy() for one in network.state_dict().values()]


def test_a_training_that_was_stopped_and_goes_on_ends_as_one_that_was_not(tmp_path: Path) -> None:
    whole = Training(Line(), settings(), tmp_path / "whole").run(QUIET)
    with pytest.raises(Interrupted) as stop:
        Training(Line(stop_at=11), settings(), tmp_path / "parts").run(QUIET)
    assert stop.value.step == 12
    parts = Training(Line(), settings(), tmp_path / "parts").run(QUIET)
    for one, other in zip(weights(whole), weights(parts), strict=True):
        assert np.array_equal(one, other)


def test_a_finished_training_is_not_trained_further(tmp_path: Path) -> None:
    first = Training(Line(), settings(), tmp_path).run(QUIET)
    again = Training(Line(stop_at=0), settings(), tmp_path).run(QUIET)
    for one, other in zip(weights(first), weights(again), strict=True):
        assert np.array_equal(one, other)


def test_the_loss_falls_and_the_curve_shows_it(tmp_path: Path) -> None:
    Training(Line(), settings(steps=200), tmp_path).run(QUIET)
    with (tmp_path / "curve.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == list(range(20, 201, 20))
    assert float(rows[-1]["loss"]) < 0.8 * float(rows[0]["loss"])
    assert (tmp_path / "curve.png").stat().st_size > 1000


def test_rows_after_the_checkpoint_are_written_once(tmp_path: Path) -> None:
    training = Training(Line(), settings(steps=60), tmp_path)
    training.run(QUIET)
    training.curve.cut(20)
    steps = [row.split(",")[0] for row in (tmp_path / "curve.csv").read_text().splitlines()]
    assert steps == ["step", "20"]


def test_another_training_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    Training(Line(), settings(), tmp_path).run(QUIET)
    with pytest.raises(DataError, match=r"other settings \(seed: 0, now 3\).*--restart"):
        Training(Line(), settings(seed=3), tmp_path)


def test_a_broken_checkpoint_is_no_traceback(tmp_path: Path) -> None:
    Training(Line(), settings(), tmp_path).run(QUIET)
    content = (tmp_path / "checkpoint.pt").read_bytes()
    for broken in (content[: len(content) // 2], b"weights", b""):
        (tmp_path / "checkpoint.pt").write_bytes(broken)
        with pytest.raises(DataError, match=r"cannot be resumed.*--restart"):
            Training(Line(), settings(), tmp_path)


def test_a_loss_that_is_no_number_ends_the_training_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the loss is nan at step 0"):
        Training(Line(poison=True), settings(), tmp_path).run(QUIET)


def begun(network: torch.nn.Module, other: torch.nn.Module, folder: Path) -> bool:
    """From a checkpoint with nothing but what another training begins with."""
    path = folder / "checkpoint.pt"
    torch.save({"averaged": other.state_dict()}, path)
    return begin_with(network, weights_of_training(path), folder)


def test_a_detector_begins_with_the_backbone_and_pyramid_of_a_segmenter(tmp_path: Path) -> None:
    segmenter = PyramidSegmenter(ResidualBackbone(3), 16)
    detector = CenterNet(ResidualBackbone(3), 3)
    head = detector.heat.weight.clone()
    assert not begun(detector, segmenter, tmp_path)
    for name, one in segmenter.state_dict().items():
        if name.startswith(("backbone.", "pyramid.")):
            assert torch.equal(detector.state_dict()[name], one)
    assert torch.equal(detector.heat.weight, head)
    assert begun(CenterNet(ResidualBackbone(3), 3), detector, tmp_path)


def test_a_scan_network_without_remission_begins_with_the_rest_of_one_that_has_it(
    tmp_path: Path,
) -> None:
    five, four = (SalsaNext(6, channels=count, width=0.25) for count in (5, 4))
    assert begun(four, five, tmp_path)
    shape = torch.randn(1, 4, 32, 32)
    unheard = torch.cat([shape, torch.zeros(1, 1, 32, 32)], dim=1)
    with torch.no_grad():
        assert torch.allclose(four.eval()(shape), five.eval()(unheard), atol=1e-5)
    with pytest.raises(DataError, match="cannot be begun with"):  # and not the other way round
        begun(five, four, tmp_path)


def test_a_network_on_another_backbone_cannot_be_begun_with(tmp_path: Path) -> None:
    other = CenterNet(MobileDet(3, 0.5), 3)
    with pytest.raises(DataError, match=r"backbone and pyramid.*name the folder or .xml"):
        begun(CenterNet(ResidualBackbone(3), 3), other, tmp_path)


def test_what_is_no_training_cannot_be_begun_with(tmp_path: Path) -> None:
    broken = tmp_path / "checkpoint.pt"
    torch.save({"weights": {}}, broken)
    content = broken.read_bytes()
    for held in (None, content, content[: len(content) // 2], b"", b"weights"):
        if held is None:
            broken.unlink()
        else:
            broken.write_bytes(held)
        with pytest.raises(DataError, match=r"cannot be begun with.*name the folder of a training"):
            weights_of_training(broken)


def test_the_rate_rises_and_falls_to_nothing() -> None:
    rates = [settings(steps=100).rate_at(step) for step in range(101)]
    assert rates[0] < rates[3] == pytest.approx(0.02)
    assert rates[4:] == sorted(rates[4:], reverse=True)
    assert rates[100] == pytest.approx(0, abs=1e-9)


def test_a_step_gathers_the_gradients_of_several_batches(tmp_path: Path) -> None:
    class Counting(Line):
        drawn = 0

        def batch(self, random: np.random.Generator) -> dict[str, torch.Tensor]:
            self.drawn += 1
            return super().batch(random)

    one, four = Counting(), Counting()
    Training(one, settings(steps=5), tmp_path / "one").run(QUIET)
    Training(four, settings(steps=5, gathered=4), tmp_path / "four").run(QUIET)
    assert (one.drawn, four.drawn) == (5, 20)
    assert any(
        (a != b).any() for a, b in zip(weights(one.network), weights(four.network), strict=True)
    )


@pytest.mark.skipif(
    "x86" not in platform.machine() or not Path("/proc/cpuinfo").is_file(),
    reason="the flags of an x86 CPU are read from Linux",
)
def test_bfloat16_is_used_where_the_cpu_multiplies_it_itself() -> None:
    """Not where it is emulated: there a step takes two to three times as long as in float32."""
    flags = Path("/proc/cpuinfo").read_text().partition("flags")[2].partition("\n")[0].split()
    assert has_bfloat16() == bool({"avx512_bf16", "amx_bf16"} & set(flags))
