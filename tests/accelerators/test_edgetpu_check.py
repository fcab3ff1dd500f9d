from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tiny_models import write_tflite

from accelerators.edgetpu_check import AFTER_THE_CUT, EdgeTpuReport, check_file, check_graph
from accelerators.flatbuffer import Table
from accelerators.tflite_file import Operation, TfliteGraph, TfliteTensor, read_graph
from pipeline.errors import ModelError
from pipeline.model import TensorSpec

TWINS = (
    "deeplab_mobilenet_edgetpu_slim_cityscapes_quant",
    "deeplabv3_mnv2_dm05_pascal_quant",
    "deeplabv3_mnv2_pascal_quant",
)
IMAGE = (1, 8, 8, 4)


@pytest.mark.parametrize("name", TWINS)
def test_the_prediction_is_what_the_real_compiler_left_to_the_cpu(shared: Path, name: str) -> None:
    folder = shared / "models" / "coral"
    report = check_file(folder / f"{name}.tflite")
    predicted = [
        (one.name, one.output, one.shape) for one in report.operations if not one.on_device
    ]

    compiled = read_graph((folder / f"{name}_edgetpu.tflite").read_bytes())
    assert compiled.operations[0].name == "edgetpu-custom-op"
    left = [
        (
            one.name,
            compiled.tensors[one.outputs[0]].name,
            compiled.tensors[one.outputs[0]].spec.shape,
        )
        for one in compiled.operations[1:]
    ]
    assert predicted == left
    assert report.mapped == len(report.operations) - len(left)


def test_the_cut_is_named_and_what_follows_it_is_not(shared: Path) -> None:
    report = check_file(shared / "models" / "coral" / f"{TWINS[2]}.tflite")
    (cut,) = report.cuts
    assert (cut.number, cut.name) == (64, "RESIZE_BILINEAR")
    assert cut.reason == "enlarges 33 times, which the compiler refuses to avoid loss in precision"
    assert report.operations[66].reason == AFTER_THE_CUT  # a concatenation, which it could run
    assert report.operations[71].reason == "is not an operation of the Edge TPU"  # the arg max
    assert report.parameter_bytes == pytest.approx(2.0e6, rel=0.01)


def tensor(
    shape: Sequence[int] = IMAGE, dtype: str = "uint8", content: bytes | None = None
) -> TfliteTensor:
    return TfliteTensor(f"{dtype} {shape}", TensorSpec(tuple(shape), dtype), True, content)


def constant(values: Sequence[int]) -> TfliteTensor:
    return tensor((len(values),), "int32", struct.pack(f"<{len(values)}i", *values))


def chain(*names: str, dtypes: Sequence[str] = ()) -> EdgeTpuReport:
    """The report on operations in a row; `dtypes` of the tensors between, the first the input."""
    types = dtypes or ["uint8"] * (len(names) + 1)
    tensors = tuple(tensor(dtype=dtype) for dtype in types)
    operations = tuple(Operation(name, (i,), (i + 1,), None) for i, name in enumerate(names))
    return check_graph(TfliteGraph(tensors, operations, (0,), (len(names),)))


def one(
    name: str, inputs: Sequence[TfliteTensor], output: TfliteTensor, options: Table | None = None
) -> str:
    """Why one operation would stay on the CPU."""
    numbers = tuple(range(len(inputs)))
    operation = Operation(name, numbers, (len(inputs),), options)
    graph = TfliteGraph((*inputs, output), (operation,), (0,), (len(inputs),))
    return check_graph(graph).operations[0].reason


def test_the_graph_is_cut_once() -> None:
    report = chain("RELU", "LOGISTIC", "ARG_MAX", "RELU", "GATHER", "RELU")
    assert [placed.on_device for placed in report.operations] == [True, True, *[False] * 4]
    assert [cut.number for cut in report.cuts] == [2]
    assert [placed.reason == AFTER_THE_CUT for placed in report.operations[3:]] == [
        True,
        False,
        True,
    ]


def test_a_branch_that_does_not_come_from_the_cut_is_still_mapped() -> None:
    # 0 -> ARG_MAX -> 1; 0 -> RELU -> 2, listed after it; 1 + 2 -> CONCATENATION -> 3
    operations = (
        Operation("GATHER", (0,), (1,), None),
        Operation("RELU", (0,), (2,), None),
        Operation("CONCATENATION", (1, 2), (3,), None),
    )
    report = check_graph(TfliteGraph((tensor(),) * 4, operations, (0,), (3,)))
    assert [placed.on_device for placed in report.operations] == [False, True, False]


def test_a_float_ended_network_is_mapped_between_its_ends() -> None:
    # As the compiler's logs of such networks say.
    report = chain(
        "QUANTIZE", "RELU", "RELU", "DEQUANTIZE", dtypes=["float32", *["int8"] * 3, "float32"]
    )
    assert [placed.on_device for placed in report.operations] == [False, True, True, False]
    assert [cut.name for cut in report.cuts] == ["DEQUANTIZE"]


def test_a_float_network_is_not_mapped_at_all() -> None:
    report = chain("RELU", "RELU", dtypes=["float32"] * 3)
    assert report.mapped == report.parameter_bytes == 0
    assert report.cuts[0].reason.startswith("works on float32, not on 8-bit integers")


IMAGE_IN = [tensor()]


@pytest.mark.parametrize(
    ("name", "inputs", "output", "said"),
    [
        ("RELU", [tensor((2, 8, 8, 4))], tensor((2, 8, 8, 4)), "only the three innermost sizes"),
        ("RELU", [tensor((1, 1, 8, 8, 4))], tensor((1, 1, 8, 8, 4)), ""),
        ("LEAKY_RELU", IMAGE_IN, tensor(), "is not an operation of the Edge TPU"),
        ("CONV_2D", [tensor(), tensor((1, 3, 3, 4))], tensor(), "weights that are computed"),
        ("CONV_2D", [tensor(), tensor((4, 3, 3, 4), content=b"1")], tensor(), ""),
        ("RESIZE_BILINEAR", IMAGE_IN, tensor((1, 16, 16, 4)), ""),
        ("RESIZE_BILINEAR", IMAGE_IN, tensor((1, 8, 96, 4)), "enlarges 12 times"),
        ("RESIZE_BILINEAR", [tensor((1, 512, 512, 32))], tensor((1, 1024, 1024, 32)), "too many"),
        ("SOFTMAX", [tensor((1, 1000))], tensor((1, 1000)), ""),
        ("SOFTMAX", [tensor((1, 20_000))], tensor((1, 20_000)), "more than 16,000 values"),
        ("SOFTMAX", IMAGE_IN, tensor(), "more than one dimension"),
        ("PAD", [tensor(), constant([0, 0, 1, 1, 1, 1, 0, 0])], tensor((1, 10, 10, 4)), ""),
        ("PAD", [tensor(), constant([1, 0, 0, 0, 0, 0, 0, 0])], tensor(), "pads the batch"),
        ("MEAN", [tensor(), constant([1, 2])], tensor((1, 4)), ""),
        ("MEAN", [tensor(), constant([0])], tensor((8, 8, 4)), "reduces over the batch"),
        ("MEAN", [tensor((1, 8, 8, 3)), constant([-1])], tensor((1, 8, 8)), "no multiple of 4"),
        ("PRELU", [tensor(), tensor((1, 1, 4), content=b"1")], tensor(), ""),
        ("PRELU", [tensor(), tensor((8, 8, 4), content=b"1")], tensor(), "by place"),
        ("SQUEEZE", [tensor((1, 1, 8))], tensor((8,)), ""),
        ("SQUEEZE", [tensor((5, 1, 10))], tensor((5, 10)), "not the leading ones"),
        (
            "STRIDED_SLICE",
            [tensor(), *[constant([0])] * 2, constant([2])],
            tensor(),
            "stride other",
        ),
        ("CONCATENATION", [tensor(), tensor(content=b"\0\0")], tensor((1, 8, 8, 8)), ""),
        ("CONCATENATION", [tensor(), tensor(content=b"\0\1")], tensor((1, 8, 8, 8)), "of zeros"),
        (
            "FULLY_CONNECTED",
            [tensor((4, 4)), tensor((4, 4), content=b"1")],
            tensor((4, 4)),
            "one dim",
        ),
    ],
)
def test_each_limit_of_the_table(
    name: str, inputs: Sequence[TfliteTensor], output: TfliteTensor, said: str
) -> None:
    found = one(name, inputs, output)
    assert (said in found) if said else found == ""


def test_an_open_size_is_not_mapped() -> None:
    open_size = TfliteTensor("x", TensorSpec(IMAGE, "uint8"), False, None)
    assert "has an open size ('x')" in one("RELU", [open_size], tensor())


def pooling(activation: int) -> Table:
    """Pool2DOptions with nothing but its activation, field 5."""
    table = struct.pack("<b", activation)
    vtable = struct.pack("<8H", 16, 5, *[0] * 5, 4)
    return Table(vtable + struct.pack("<i", len(vtable)) + table, len(vtable))


def test_an_activation_fused_into_a_pooling_is_not_mapped() -> None:
    assert one("MAX_POOL_2D", IMAGE_IN, tensor((1, 4, 4, 4)), pooling(0)) == ""
    assert "fused activation" in one("MAX_POOL_2D", IMAGE_IN, tensor((1, 4, 4, 4)), pooling(1))


def test_constants_count_once_as_parameters() -> None:
    weights = tensor((4, 1, 1, 4), content=np.ones(16, np.uint8).tobytes())
    operations = tuple(Operation("CONV_2D", (i, 3), (i + 1,), None) for i in range(2))
    graph = TfliteGraph((tensor(), tensor(), tensor(), weights), operations, (0,), (2,))
    assert check_graph(graph).parameter_bytes == 16


def test_what_is_no_tflite_or_compiled_already_is_refused(tmp_path: Path, shared: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"\x08\x08 an onnx model")
    with pytest.raises(ModelError, match=r"net\.onnx: is not a TensorFlow Lite model"):
        check_file(tmp_path / "net.onnx")
    with pytest.raises(ModelError, match="cannot be read"):
        check_file(tmp_path / "gone.tflite")
    with pytest.raises(
        ModelError, match=r"already compiled for the Edge TPU; check the \.tflite it"
    ):
        check_file(shared / "models" / "coral" / f"{TWINS[0]}_edgetpu.tflite")
    write_tflite(tmp_path / "tiny.tflite")
    content = (tmp_path / "tiny.tflite").read_bytes()
    (tmp_path / "short.tflite").write_bytes(content[: len(content) // 2])
    with pytest.raises(ModelError, match=r"short\.tflite: "):
        check_file(tmp_path / "short.tflite")
