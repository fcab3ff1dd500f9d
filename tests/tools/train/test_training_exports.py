"""Files that say what their networks say, and a whole training in miniature."""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from rich.console import Console  # noqa: E402

from accelerators.model_file import read_interface  # noqa: E402
from accelerators.openvino import OpenVino  # noqa: E402
from accelerators.registry import Registry  # noqa: E402
from pipeline.errors import DataError, ModelError  # noqa: E402
from tools.annotated_images import read_annotated  # noqa: E402
from tools.evaluate_detections import judge, open_model, summary  # noqa: E402
from tools.train.detect import train_detector  # noqa: E402
from tools.train.export import (  # noqa: E402
    Exportable,
    rounding,
    write_onnx,
    write_openvino,
    write_tflite,
)
from tools.train.plan import Order  # noqa: E402
from tools.train.recipes import DetectorRecipe  # noqa: E402
from tools.train.salsanext import SalsaNext  # noqa: E402

TINY = DetectorRecipe(
    name="detect-tiny",
    description="Bright squares",
    size=(64, 32),
    channels=1,
    odds={"person": 0.5, "vehicle": 0.5},
    side=64,
)


def test_the_pixel_shuffle_survives_its_export(tmp_path: Path) -> None:
    torch.manual_seed(1)
    network = SalsaNext(16, width=0.25).eval()
    model = Exportable("scan", network, (5, 16, 32), network.output_names)
    onnx = write_onnx(model, tmp_path)
    write_openvino(model, onnx, tmp_path)
    pixels = np.random.default_rng(5).standard_normal((1, 5, 16, 32)).astype(np.float32)
    wanted = network(torch.from_numpy(pixels)).detach().numpy()
    for file, tolerance in ((onnx, 1e-3), (tmp_path / "scan.xml", 2e-2)):
        found = OpenVino().load(str(file), {}).infer({"image": pixels})["scores"]
        assert np.abs(found - wanted).max() < tolerance * np.abs(wanted).max()


class Moody(torch.nn.Module):
    """Answers otherwise each time: what an exporter's bug looks like from outside."""

    output_names = ("scores",)

    def __init__(self) -> None:
        super().__init__()
        self.convolution = torch.nn.Conv2d(1, 1, 1)
        self.asked = 0

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        self.asked += 1
        scores: torch.Tensor = self.convolution(image) + self.asked
        return scores


def test_a_file_that_says_something_else_than_its_network_is_refused(tmp_path: Path) -> None:
    model = Exportable("moody", Moody(), (1, 4, 4), ("scores",))
    with pytest.raises(ModelError, match=r"moody\.onnx: 'scores' differs from the network"):
        write_onnx(model, tmp_path)


def eight_bit(folder: Path) -> tuple[set[str], list[str], float]:
    """Types and outputs of an 8-bit file of a small network, and how far it is from it."""
    torch.manual_seed(2)
    network = SalsaNext(16, width=0.25).eval()
    model = Exportable("scan", network, (5, 16, 32), network.output_names)
    network.to(memory_format=torch.channels_last)  # as training leaves it
    random = np.random.default_rng(6)
    samples = [random.standard_normal((5, 16, 32)).astype(np.float32) for _ in range(4)]
    path = write_tflite(model, samples, folder)
    interface = read_interface(path)
    types = {one.dtype for one in (*interface.inputs.values(), *interface.outputs.values())}
    return types, list(interface.outputs), rounding(path, model, samples[0])["scores"]


@pytest.mark.slow
def test_an_8_bit_file_is_8_bit_from_end_to_end_and_follows_its_network(tmp_path: Path) -> None:
    if importlib.util.find_spec("litert_torch") is None:
        pytest.skip("the extra 'export' is not installed")
    # In a process of its own: the converter brings JAX, which warns of every fork that follows.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        types, outputs, share = pool.submit(eight_bit, tmp_path).result()
    assert types == {"int8"}
    assert outputs == ["scores"]
    assert share < 0.2


def squares(folder: Path) -> Path:
    """Four annotated images with a bright square each."""
    folder.mkdir()
    content: dict[str, list[Mapping[str, object]]] = {
        "images": [],
        "annotations": [],
        "categories": [{"id": 1, "name": "person"}, {"id": 2, "name": "car"}],
    }
    for number in range(4):
        pixels = np.full((64, 96), 40, np.uint8)
        x, y = 20 + 10 * number, 12 + 8 * number
        pixels[y : y + 16, x : x + 16] = 230
        cv2.imwrite(str(folder / f"{number}.png"), pixels)
        content["images"].append(
            {"id": number, "file_name": f"{number}.png", "width": 96, "height": 64}
        )
        content["annotations"].append(
            {"image_id": number, "category_id": 1 + number % 2, "bbox": [x, y, 16, 16]}
        )
    (folder / "ann.json").write_text(json.dumps(content))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("head", ["centernet", "ssd"])
def test_a_training_of_two_steps_leaves_a_model_that_a_graph_can_name(
    head: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "litert_torch", None)  # as without the extra `export`
    data = squares(tmp_path / "data")
    order = Order(
        data=data,
        output=tmp_path / "out",
        steps=2,
        seed=0,
        threads=1,
        license="CC0-1.0",
        attribution="nobody",
        judged_on=data,
        restart=False,
        as_it_is=False,
        command="overflight train detect-tiny",
    )
    registry = train_detector(TINY, order, "residual", head, Console(quiet=True))
    models = Registry.open(registry)
    kinds = [variant.kind for variant in models.entry("detect-tiny").variants]
    assert kinds == ["openvino", "onnx"]
    bound, _ = open_model(models, "detect-tiny", "onnx")
    verdict = summary(judge(bound, read_annotated(data), min_iou=0.5))
    assert {name: row["objects"] for name, row in verdict["classes"].items()} == {
        "person": 2,
        "vehicle": 2,
    }
    card = (tmp_path / "out" / "detect-tiny.md").read_text()
    for words in ("CC0-1.0", "person 2, vehicle 2", f"{head} on a residual backbone", "AP50"):
        assert words in card
    written = (tmp_path / "out" / "detect-tiny.onnx").read_bytes()
    longer = replace(order, output=tmp_path / "none", as_it_is=True)
    with pytest.raises(DataError, match="holds no training to be written as it is"):
        train_detector(TINY, longer, "residual", head, Console(quiet=True))
    again = train_detector(
        TINY, replace(order, as_it_is=True), "residual", head, Console(quiet=True)
    )
    assert again == registry
    assert (tmp_path / "out" / "detect-tiny.onnx").read_bytes() == written
