"""One tiny network, y = relu(x) on (1, 2, 3, 3) float32, in every file format we run.

Written byte by byte, so that the contract of the accelerators is tested without any weights.
"""

from __future__ import annotations

from pathlib import Path

SHAPE = (1, 2, 3, 3)


def write_tflite(path: Path, operators: int = 1, *, compiled: int = 0) -> None:
    """A chain of `operators` relus; tensor i + 1 is computed by operator i.

    The first `compiled` of them are what the Edge TPU compiler leaves in their place.
    """
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    model = schema.ModelT()
    model.version = 3
    model.buffers = [schema.BufferT()]
    relu = schema.OperatorCodeT()
    relu.builtinCode = relu.deprecatedBuiltinCode = schema.BuiltinOperator.RELU
    edgetpu = schema.OperatorCodeT()
    edgetpu.builtinCode = edgetpu.deprecatedBuiltinCode = schema.BuiltinOperator.CUSTOM
    edgetpu.customCode = "edgetpu-custom-op"
    model.operatorCodes = [relu, edgetpu] if compiled else [relu]
    graph = schema.SubGraphT()
    graph.tensors, graph.operators = [], []
    for number in range(operators + 1):
        tensor = schema.TensorT()
        tensor.shape, tensor.type = list(SHAPE), schema.TensorType.FLOAT32
        tensor.buffer, tensor.name = 0, "x" if number == 0 else f"y{number}"
        graph.tensors.append(tensor)
    for number in range(operators):
        operator = schema.OperatorT()
        operator.opcodeIndex = 1 if number < compiled else 0
        operator.inputs, operator.outputs = [number], [number + 1]
        graph.operators.append(operator)
    graph.inputs, graph.outputs = [0], [operators]
    model.subgraphs = [graph]
    builder = flatbuffers.Builder(1024)
    builder.Finish(model.Pack(builder), b"TFL3")
    path.write_bytes(bytes(builder.Output()))


def write_edgetpu(path: Path) -> None:
    """The network as the Edge TPU compiler would leave it, for the stub delegate."""
    write_tflite(path, compiled=1)


def write_openvino(path: Path) -> None:
    dims = "".join(f"<dim>{size}</dim>" for size in SHAPE)
    port = f'precision="FP32">{dims}</port>'
    shape = ",".join(map(str, SHAPE))
    path.write_text(
        f"""<?xml version="1.0"?><net name="tiny" version="11"><layers>
        <layer id="0" name="x" type="Parameter" version="opset1">
          <data shape="{shape}" element_type="f32"/>
          <output><port id="0" names="x" {port}</output></layer>
        <layer id="1" name="relu" type="ReLU" version="opset1">
          <input><port id="0" {port}</input>
          <output><port id="1" names="y1" {port}</output></layer>
        <layer id="2" name="result" type="Result" version="opset1">
          <input><port id="0" {port}</input></layer>
        </layers><edges>
        <edge from-layer="0" from-port="0" to-layer="1" to-port="0"/>
        <edge from-layer="1" from-port="1" to-layer="2" to-port="0"/>
        </edges></net>"""
    )


def write_onnx(path: Path) -> None:
    def number(field: int, value: int) -> bytes:
        return bytes([field << 3, value])

    def block(field: int, content: bytes | str) -> bytes:
        content = content.encode() if isinstance(content, str) else content
        assert len(content) < 128
        return bytes([field << 3 | 2, len(content)]) + content

    def tensor(name: str) -> bytes:
        dims = b"".join(block(1, number(1, size)) for size in SHAPE)
        return block(1, name) + block(2, block(1, number(1, 1) + block(2, dims)))

    node = block(1, "x") + block(2, "y1") + block(4, "Relu")
    graph = block(1, node) + block(2, "tiny") + block(11, tensor("x")) + block(12, tensor("y1"))
    path.write_bytes(number(1, 8) + block(7, graph) + block(8, block(1, "") + number(2, 13)))
