from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_models import SHAPE, write_onnx, write_openvino, write_tflite

from accelerators.litert import TfliteCpu
from accelerators.model_file import find_tensor, read_interface
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from pipeline.errors import ModelError
from pipeline.model import Accelerator, TensorSpec

TINY = TensorSpec(SHAPE, "float32")
WRITERS = {".tflite": write_tflite, ".onnx": write_onnx, ".xml": write_openvino}


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_is_read_without_its_runtime(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"tiny{suffix}"
    WRITERS[suffix](path)  # type: ignore[operator]
    interface = read_interface(path)
    assert interface.inputs == {"x": TINY}
    assert interface.outputs == {"y1": TINY}


def test_a_cut_tflite_has_the_tensors_asked_for_as_outputs(tmp_path: Path) -> None:
    write_tflite(tmp_path / "chain.tflite", operators=3)
    assert list(read_interface(tmp_path / "chain.tflite").outputs) == ["y3"]
    assert list(read_interface(tmp_path / "chain.tflite", (2,)).outputs) == ["y2"]
    assert find_tensor(tmp_path / "chain.tflite", "y2") == (2, TINY)
    assert find_tensor(tmp_path / "chain.tflite", "y9") is None


def test_shipped_files_are_read_as_their_runtimes_state_them(shared: Path) -> None:
    runtimes: dict[str, Accelerator] = {
        "tflite": TfliteCpu(),
        "onnx": Onnx(),
        "openvino": OpenVino(),
    }
    folder = shared / "models"
    seen = set()
    for path in (
        folder / "coral" / "deeplab_mobilenet_edgetpu_slim_cityscapes_quant.tflite",
        folder / "made" / "ssdlite_mnv2_pedestrian_300_int8.tflite",
        folder / "fastestdet" / "example" / "onnx-runtime" / "FastestDet.onnx",
        folder / "omz" / "person-vehicle-bike-detection-2000.FP16-INT8.xml",
    ):
        interface = read_interface(path)
        model = runtimes[interface.kind].load(str(path), {})
        assert (interface.inputs, interface.outputs) == (model.inputs, model.outputs)
        seen.add(interface.kind)
    assert seen == set(runtimes)


def test_a_compiled_file_is_told_from_one_that_is_not(shared: Path) -> None:
    name = "deeplabv3_mnv2_dm05_pascal_quant"
    plain, compiled = (
        read_interface(shared / "models" / "coral" / f"{name}{end}.tflite")
        for end in ("", "_edgetpu")
    )
    assert (plain.kind, compiled.kind) == ("tflite", "edgetpu")
    assert (plain.inputs, plain.outputs) == (compiled.inputs, compiled.outputs)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.onnx", b""),
        ("text.onnx", b"no model at all" * 10),
        ("net.xml", b"<net><layers/></net>"),
        ("text.xml", b"no model at all"),
        ("cut.tflite", b"\x1c\x00\x00\x00TFL3\x00\x00"),
        ("photo.png", b"\x89PNG"),
    ],
)
def test_what_is_no_model_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelError, match=name):
        read_interface(tmp_path / name)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.onnx: cannot be read \(No such file"):
        read_interface(tmp_path / "gone.onnx")


@pytest.mark.parametrize("suffix", [".onnx", ".xml"])
@given(data=st.data())
@settings(max_examples=200)
def test_a_damaged_file_is_a_model_error_and_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    WRITERS[suffix](path)  # type: ignore[operator]
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with contextlib.suppress(ModelError):
        read_interface(path)
