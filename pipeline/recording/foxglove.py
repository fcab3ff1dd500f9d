"""Foxglove's message schemas in Protocol Buffers, as far as we write them.

Names, numbers and types are those of github.com/foxglove/foxglove-sdk (schemas/proto), so that
Foxglove and Rerun show a recording as it is. Fields from 1000 on are ours: a reader that does not
know them skips them. The file keeps the schema with them, so nothing is hidden.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from pipeline.message import Message
from pipeline.recording.codec import Schema

#: name:number:type, a `*` behind a repeated type, a `.` before an enumeration of `_ENUMS`. `_OURS`
#: is appended to what has a timestamp.
_MESSAGES = {
    "Vector3": "x:1:double y:2:double z:3:double",
    "Quaternion": "x:1:double y:2:double z:3:double w:4:double",
    "Pose": "position:1:Vector3 orientation:2:Quaternion",
    "Point2": "x:1:double y:2:double",
    "Color": "r:1:double g:2:double b:3:double a:4:double",
    "CompressedImage": "timestamp:1:Timestamp data:2:bytes format:3:string frame_id:4:string "
    "unit_m:1003:double",
    "RawImage": "timestamp:1:Timestamp width:2:fixed32 height:3:fixed32 encoding:4:string "
    "step:5:fixed32 data:6:bytes frame_id:7:string unit_m:1003:double",
    "PackedElementField": "name:1:string offset:2:fixed32 type:3:.NumericType",
    "PointCloud": "timestamp:1:Timestamp frame_id:2:string pose:3:Pose point_stride:4:fixed32 "
    "fields:5:PackedElementField* data:6:bytes "
    "rows:1003:fixed32 columns:1004:fixed32 column_times_ns:1005:sint32* voxel_m:1006:double "
    "payload:1007:bytes",
    "FrameTransform": "timestamp:1:Timestamp parent_frame_id:2:string child_frame_id:3:string "
    "translation:4:Vector3 rotation:5:Quaternion matrix:1003:double*",
    "FrameTransforms": "transforms:1:FrameTransform*",
    "CameraCalibration": "timestamp:1:Timestamp width:2:fixed32 height:3:fixed32 "
    "distortion_model:4:string D:5:double* K:6:double* R:7:double* P:8:double* frame_id:9:string",
    "PointsAnnotation": "timestamp:1:Timestamp type:2:.Type points:3:Point2* "
    "outline_color:4:Color outline_colors:5:Color* fill_color:6:Color thickness:7:double",
    "TextAnnotation": "timestamp:1:Timestamp position:2:Point2 text:3:string font_size:4:double "
    "text_color:5:Color background_color:6:Color",
    "ImageAnnotations": "points:2:PointsAnnotation* texts:3:TextAnnotation* timestamp:5:Timestamp "
    "frame_id:1003:string scores:1004:float*",
}
_OURS = " begin_ns:1001:sint64 end_ns:1002:sint64"
#: Within the message that uses it.
_ENUMS = {
    "PackedElementField": (
        "NumericType",
        "UNKNOWN UINT8 INT8 UINT16 INT16 UINT32 INT32 FLOAT32 FLOAT64",
    ),
    "PointsAnnotation": ("Type", "UNKNOWN POINTS LINE_LOOP LINE_STRIP LINE_LIST"),
}
#: numpy's name of each ``NumericType``.
NUMERIC = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}
LINE_LOOP = 2
#: Fields whose bytes are written by hand.
_DATA, _PAYLOAD = 6, 1007

_PACKAGE = "foxglove"


def new(name: str) -> Any:
    """An empty message, e.g. of ``PointCloud``."""
    return _classes()[name]()


def parse(name: str, data: bytes) -> Any:
    """The message of some bytes. Raises ValueError where they are none."""
    try:
        return _classes()[name].FromString(data)
    except Exception as error:  # the library's DecodeError is not public in all its backends
        raise ValueError(f"not a foxglove.{name}: {error}") from error


def with_data(proto: Any, data: Any, payload: bytes | None = None) -> bytes:
    """The bytes of a message whose field `data` (6, the pixels or points) is this buffer.

    Written by hand behind the others, which Protocol Buffers allow: set the usual way, a buffer is
    copied three times (a color frame took 0.32 ms and takes 0.11). `payload` is a field of ours.
    """
    parts = [proto.SerializeToString(), *_field(_DATA, memoryview(data))]
    if payload is not None:
        parts += _field(_PAYLOAD, memoryview(payload))
    return b"".join(parts)


def _field(number: int, view: memoryview) -> tuple[bytes, bytes, memoryview]:
    """A field of bytes: its tag, its length, themselves."""
    return _varint(number << 3 | 2), _varint(view.nbytes), view


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)


@cache
def schema(name: str) -> Schema:
    """The schema of a message for the file."""
    files = descriptor_pb2.FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(files.file.add())
    files.file.append(_file())
    return Schema(f"{_PACKAGE}.{name}", "protobuf", files.SerializeToString(), "protobuf")


def put_times(proto: Any, message: Message[Any]) -> None:
    """Write a message's stamp and extent."""
    proto.timestamp.seconds, proto.timestamp.nanos = divmod(message.stamp, 1_000_000_000)
    proto.begin_ns = message.begin - message.stamp
    proto.end_ns = message.end - message.stamp


def times(proto: Any) -> tuple[int, int, int]:
    """(stamp, begin, end), ns."""
    stamp = proto.timestamp.seconds * 1_000_000_000 + proto.timestamp.nanos
    return stamp, stamp + proto.begin_ns, stamp + proto.end_ns


@cache
def _classes() -> dict[str, Any]:
    # A pool of our own: the default one may hold Foxglove's generated classes.
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(_file().SerializeToString())
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))
        for name in _MESSAGES
    }


@cache
def _file() -> Any:
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove/overflight.proto",
        package=_PACKAGE,
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        if name in _ENUMS:
            enum = message.enum_type.add(name=_ENUMS[name][0])
            for number, value in enumerate(_ENUMS[name][1].split()):
                enum.value.add(name=value, number=number)
        for text in (fields + (_OURS if "timestamp" in fields else "")).split():
            _add_field(message, *text.split(":"))
    return file


def _add_field(message: Any, name: str, number: str, kind: str) -> None:
    types = descriptor_pb2.FieldDescriptorProto
    field = message.field.add(name=name, number=int(number))
    field.label = types.LABEL_REPEATED if kind.endswith("*") else types.LABEL_OPTIONAL
    kind = kind.removesuffix("*")
    if kind.startswith("."):
        field.type, field.type_name = types.TYPE_ENUM, f".{_PACKAGE}.{message.name}{kind}"
    elif kind[0].isupper():
        scope = "google.protobuf" if kind == "Timestamp" else _PACKAGE
        field.type, field.type_name = types.TYPE_MESSAGE, f".{scope}.{kind}"
    else:
        field.type = getattr(types, f"TYPE_{kind.upper()}")
