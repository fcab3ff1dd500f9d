from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from tiny_models import write_onnx, write_tflite

from accelerators.model_file import Interface
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.registry import Registry
from accelerators.registry_file import VariantEntry
from pipeline.model import TensorSpec
from tools.models import convert

Overflight = Callable[..., Any]
WORDS = ("--head", "scores", "--classes", "0=road,1=building,2=vehicle")
CONVERTS = all(importlib.util.find_spec(one) for one in ("tf2onnx", "tensorflow"))


@pytest.fixture
def tiny(tmp_path: Path, overflight: Overflight) -> Path:
    """A registry with one network that has an 8-bit file alone, cut inside."""
    write_tflite(tmp_path / "tiny.tflite", operators=3)
    words = ("models", "add", "tiny.tflite", "--name", "tiny", "--output", "scores=y1", *WORDS)
    assert overflight(*words).code == 0
    return tmp_path / "models.yaml"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Sequence[str]]]:
    """What is asked of the converter, in whose place a file is written at once."""
    calls: list[tuple[str, Sequence[str]]] = []

    def written(tflite: Path, outputs: Sequence[str], onnx: Path) -> None:
        calls.append((tflite.name, outputs))
        write_onnx(onnx)

    monkeypatch.setattr(convert, "tflite_to_onnx", written)
    return calls


def test_a_converted_model_has_the_entry_that_it_had_and_one_more_file(
    overflight: Overflight, tiny: Path, asked: list[tuple[str, Sequence[str]]]
) -> None:
    before = Registry.open(tiny).entry("tiny")
    answer = overflight("models", "convert", "tiny")
    assert answer.code == 0
    assert answer.out.splitlines()[:2] == [
        "models.yaml: tiny has tiny_f32.onnx now, for OpenVINO and ONNX Runtime",
        "Of what an output varies by, it differs from the .tflite by: scores 0.0 %",
    ]
    assert asked == [("tiny.tflite", ["y1"])]
    models = Registry.open(tiny)
    after = models.entry("tiny")
    assert after.variants[:-1] == before.variants
    assert after.model_copy(update={"variants": before.variants}) == before
    assert after.variants[-1].file == "tiny_f32.onnx"
    assert after.variants[-1].std == before.variants[0].std
    assert after.variants[-1].outputs["scores"].tensor is None
    for device in (Onnx(), OpenVino()):
        assert models.check("tiny", device) is None
        models.load("tiny", device)


def test_a_model_of_another_registry_is_converted_into_ones_own(
    overflight: Overflight,
    asked: list[tuple[str, Sequence[str]]],
    tmp_path: Path,
) -> None:
    """Of its other files, those that are not here are no matter."""
    write_tflite(tmp_path / "mine.tflite")
    words = ("models", "add", "mine.tflite", "--name", "tiny", "--registry", "theirs.yaml", *WORDS)
    assert overflight(*words).code == 0
    text = (tmp_path / "theirs.yaml").read_text()
    gone = "    - {kind: edgetpu, file: gone_edgetpu.tflite, outputs: {scores: {}}}\n"
    (tmp_path / "theirs.yaml").write_text(text + gone)
    words = ("models", "convert", "tiny", "--models", "theirs.yaml", "--registry", "new/mine.yaml")
    answer = overflight(*words)
    assert answer.code == 0, answer.err
    entry = yaml.safe_load((tmp_path / "new" / "mine.yaml").read_text())["models"]["tiny"]
    assert [one["kind"] for one in entry["variants"]] == ["tflite", "edgetpu", "onnx"]
    rows = overflight(
        *("models", "list", "--models", "theirs.yaml", "--models", "new/mine.yaml", "--json")
    )
    variants = next(row for row in json.loads(rows.out) if row["name"] == "tiny")["variants"]
    assert [one["present"] for one in variants] == [True, False, True]


def test_what_cannot_be_converted_says_why(
    overflight: Overflight, tiny: Path, asked: list[tuple[str, Sequence[str]]]
) -> None:
    for name, said in (
        ("tinny", "no model 'tinny'; did you mean 'tiny'?"),
        ("segment-scan-1024x128", "has no .tflite file to convert; it has emulated"),
    ):
        answer = overflight("models", "convert", name)
        assert answer.code == 2
        assert said in answer.err
    assert overflight("models", "convert", "tiny").code == 0
    again = overflight("models", "convert", "tiny")
    assert again.code == 2
    assert again.err == "model 'tiny' has an .onnx file already, tiny_f32.onnx\n"
    assert len(asked) == 1


def test_a_file_that_computes_something_else_is_told(
    overflight: Overflight, tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one would whose input is read in another scale."""
    monkeypatch.setattr(convert, "tflite_to_onnx", lambda tflite, outputs, onnx: write_onnx(onnx))
    monkeypatch.setattr(convert, "normalization", lambda *said: {"mean": [0], "std": [128]})
    made = convert.convert_model("tiny", tiny)
    assert made.differences["scores"] > 1


@given(
    mean=st.floats(0, 255),
    std=st.floats(0.5, 255),
    scale=st.floats(0.001, 1),
    zero_point=st.integers(0, 255),
    value=st.integers(0, 255),
)
def test_an_8_bit_input_of_an_onnx_is_stored_as_in_the_tflite(
    mean: float, std: float, scale: float, zero_point: int, value: int
) -> None:
    source = VariantEntry(kind="tflite", mean=(mean,), std=(std,))
    quantized = TensorSpec((1, 4, 4, 3), "uint8", scale, zero_point)
    tflite = Interface("tflite", {"x": quantized}, {})
    onnx = Interface("onnx", {"x": TensorSpec((1, 4, 4, 3), "uint8")}, {})
    found = convert.normalization(source, tflite, onnx)
    stored = (value - mean) / std / scale + zero_point
    assert (value - found["mean"][0]) / found["std"][0] == pytest.approx(stored, rel=0.01, abs=0.01)
    floating = Interface("onnx", {"x": TensorSpec((1, 4, 4, 3), "float32")}, {})
    kept = convert.normalization(source, tflite, floating)
    assert kept == {"mean": [round(mean, 6)], "std": [round(std, 6)]}


@pytest.mark.skipif(CONVERTS, reason="tf2onnx is here")
def test_without_the_converter_it_says_what_to_install(overflight: Overflight, tiny: Path) -> None:
    text = tiny.read_text()
    answer = overflight("models", "convert", "tiny")
    assert answer.code == 2
    assert "pip install 'overflight[convert]'" in answer.err
    assert tiny.read_text() == text


@pytest.mark.slow
@pytest.mark.skipif(not CONVERTS, reason="needs tf2onnx: pip install 'overflight[convert]'")
def test_the_converter_cuts_and_converts(overflight: Overflight, tiny: Path) -> None:
    assert overflight("models", "convert", "tiny").code == 0
    answer = overflight("models", "check", "tiny", "--models", "models.yaml")
    assert answer.code == 0, answer.err
    (tiny.parent / "tiny.tflite").write_bytes(b"....TFL3 and no more")
    with pytest.raises(convert.ModelError, match="tf2onnx does not convert it"):
        convert.tflite_to_onnx(tiny.parent / "tiny.tflite", [], tiny.parent / "out.onnx")


@pytest.mark.slow
@pytest.mark.skipif(not CONVERTS, reason="needs tf2onnx: pip install 'overflight[convert]'")
@pytest.mark.parametrize("name", ["segment-rgb-cityscapes", "detect-person-ssdlite"])
def test_public_networks_compute_the_same_but_for_rounding(
    name: str, shared: Path, tmp_path: Path
) -> None:
    differences = convert.convert_model(name, tmp_path / "models.yaml").differences
    assert max(differences.values()) < 0.2
