"""What a model file says of its inputs and outputs, read without the runtime that runs it.

So a graph can be checked against its models on a computer that has neither the runtime nor the
device, and an entry of the registry can be written from the file itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from accelerators.tflite_file import compiled_for_edgetpu, is_tflite, read_graph
from pipeline.errors import ModelError
from pipeline.model import TensorSpec

#: The kinds of variants whose files can be read here.
KINDS = ("tflite", "edgetpu", "onnx", "openvino")


@dataclass(frozen=True, slots=True)
class Interface:
    """The ends of a network, by the names in its file."""

    kind: str  #: one of KINDS
    inputs: Mapping[str, TensorSpec]
    outputs: Mapping[str, TensorSpec]


def read_interface(path: Path, tensors: Sequence[int] = ()) -> Interface:
    """The interface of a .tflite, .onnx or OpenVINO .xml file. Raises ModelError naming the file.

    `tensors` of a .tflite are taken as its outputs (`tflite_file.cut`).
    """
    try:
        content = path.read_bytes()
        if is_tflite(content):
            return _tflite(content, tensors)
        if path.suffix == ".onnx":
            return _onnx(content)
        if path.suffix == ".xml":
            return _openvino(content)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, IndexError, KeyError, AttributeError, ElementTree.ParseError) as error:
        raise ModelError(f"{path}: cannot be read as a model ({error})") from None
    raise ModelError(
        f"{path}: is none of the model files known here: .tflite, .onnx, OpenVINO .xml"
    )


def find_tensor(path: Path, name: str) -> tuple[int, TensorSpec] | None:
    """A tensor inside a .tflite file by its name, for a variant that is cut there."""
    content = path.read_bytes()
    tensors = read_graph(content).tensors if is_tflite(content) else ()
    found = [n for n, tensor in enumerate(tensors) if tensor.name == name and not tensor.content]
    return (found[-1], tensors[found[-1]].spec) if found else None


def _tflite(content: bytes, tensors: Sequence[int]) -> Interface:
    graph = read_graph(content)
    for number in tensors:
        if number >= len(graph.tensors):
            raise ValueError(f"it has {len(graph.tensors)} tensors, and none of number {number}")
    outputs = [graph.tensors[number] for number in tensors or graph.outputs]
    return Interface(
        "edgetpu" if compiled_for_edgetpu(content) else "tflite",
        {graph.tensors[number].name: graph.tensors[number].spec for number in graph.inputs},
        {tensor.name: tensor.spec for tensor in outputs},
    )


#: numpy's names of ONNX's TensorProto.DataType, by number.
_ONNX_DTYPES = (
    "undefined",
    *("float32", "uint8", "int8", "uint16", "int16", "int32", "int64", "string", "bool"),
    *("float16", "float64", "uint32", "uint64"),
)


def _onnx(content: bytes) -> Interface:
    """Of ModelProto.graph (7): initializers (5), inputs (11) and outputs (12)."""
    graph = _last(content, 7)
    weights = {_last(initializer, 8) for number, initializer in _fields(graph) if number == 5}
    ends = {11: dict[str, TensorSpec](), 12: dict[str, TensorSpec]()}
    for number, value in _fields(graph):
        if number in ends and _last(value, 1) not in weights:
            ends[number][_last(value, 1).decode()] = _onnx_spec(_last(_last(value, 2), 1))
    if not ends[11] or not ends[12]:
        raise ValueError("no graph with inputs and outputs")
    return Interface("onnx", ends[11], ends[12])


def _onnx_spec(tensor: bytes) -> TensorSpec:
    """Of TypeProto.Tensor: elem_type (1) and shape (2) with dim (1) of dim_value (1)."""
    fields = dict(_numbers(tensor))
    dims = [dict(_numbers(dim)) for number, dim in _fields(_last(tensor, 2)) if number == 1]
    return TensorSpec(tuple(dim.get(1, -1) for dim in dims), _ONNX_DTYPES[fields[1]])


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """The length-delimited fields of a Protocol Buffers message."""
    for number, value in _all_fields(message):
        if isinstance(value, bytes):
            yield number, value


def _numbers(message: bytes) -> Iterator[tuple[int, int]]:
    """The integer fields."""
    for number, value in _all_fields(message):
        if isinstance(value, int):
            yield number, value


def _last(message: bytes, wanted: int) -> bytes:
    """The field of this number, empty where there is none; the last of several counts."""
    found = b""
    for number, value in _fields(message):
        if number == wanted:
            found = value
    return found


def _all_fields(message: bytes) -> Iterator[tuple[int, bytes | int]]:
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, form = key >> 3, key & 7
        if form == 0:
            value, at = _varint(message, at)
            yield number, value
        elif form == 2:
            size, at = _varint(message, at)
            if at + size > len(message):
                raise ValueError("the file is cut short or damaged")
            yield number, message[at : at + size]
            at += size
        elif form in (1, 5):
            at += 8 if form == 1 else 4
        else:
            raise ValueError("it is no ONNX model")


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("it is no ONNX model")


#: numpy's names of OpenVINO's element types, both spellings that an IR uses.
_OPENVINO_DTYPES = {
    spelling: name
    for name, spellings in {
        "float32": "f32 fp32",
        "float16": "f16 fp16",
        "float64": "f64 fp64",
        **{
            f"{kind}{bits}": f"{kind[0]}{bits}"
            for kind in ("int", "uint")
            for bits in (8, 16, 32, 64)
        },
        "bool": "boolean bool",
    }.items()
    for spelling in spellings.split()
}


def _openvino(content: bytes) -> Interface:
    net = ElementTree.fromstring(content)
    layers = {layer.attrib["id"]: layer for layer in net.iter("layer")}
    inputs: dict[str, TensorSpec] = {}
    outputs: dict[str, TensorSpec] = {}
    for layer in layers.values():
        if layer.attrib["type"] == "Parameter":
            inputs |= [_openvino_port(layer, "0")]
    for edge in net.iter("edge"):
        if layers[edge.attrib["to-layer"]].attrib["type"] == "Result":
            outputs |= [_openvino_port(layers[edge.attrib["from-layer"]], edge.attrib["from-port"])]
    if not inputs or not outputs:
        raise ValueError("it is no OpenVINO model")
    return Interface("openvino", inputs, outputs)


def _openvino_port(layer: ElementTree.Element, number: str) -> tuple[str, TensorSpec]:
    """The first name of an output port of a layer, and its tensor."""
    port = next(port for port in layer.iterfind("output/port") if port.attrib["id"] == number)
    dims = tuple(int(dim.text or -1) for dim in port.iterfind("dim"))
    dtype = _OPENVINO_DTYPES[port.attrib["precision"].lower()]
    name = port.attrib.get("names", layer.attrib["name"]).split(",")[0]
    return name, TensorSpec(dims, dtype)
