"""The schemas are valid Protocol Buffers, and a program without our fields still reads ours."""

from __future__ import annotations

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from pipeline.message import Message
from pipeline.recording import foxglove

#: Of github.com/foxglove/foxglove-sdk, schemas/proto/foxglove/*.proto: names and numbers of the
#: fields that any viewer reads.
PUBLISHED = {
    "CompressedImage": {"timestamp": 1, "data": 2, "format": 3, "frame_id": 4},
    "PointCloud": {
        "timestamp": 1,
        "frame_id": 2,
        "pose": 3,
        "point_stride": 4,
        "fields": 5,
        "data": 6,
    },
    "FrameTransform": {
        "timestamp": 1,
        "parent_frame_id": 2,
        "child_frame_id": 3,
        "translation": 4,
        "rotation": 5,
    },
    "CameraCalibration": {
        "timestamp": 1,
        "width": 2,
        "height": 3,
        "distortion_model": 4,
        "D": 5,
        "K": 6,
        "R": 7,
        "P": 8,
        "frame_id": 9,
    },
    "ImageAnnotations": {"points": 2, "texts": 3, "timestamp": 5},
}


def foreign(name: str) -> type:
    """The class that another program builds from the schema in the file."""
    files = descriptor_pb2.FileDescriptorSet.FromString(foxglove.schema(name).data)
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.AddSerializedFile(file.SerializeToString())
    kind: type = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
    return kind


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_fields_have_foxgloves_names_and_numbers(name: str) -> None:
    fields = {field.name: field.number for field in foreign(name).DESCRIPTOR.fields}  # type: ignore[attr-defined]
    assert {key: fields.get(key) for key in PUBLISHED[name]} == PUBLISHED[name]
    assert all(fields[key] >= 1000 for key in fields.keys() - PUBLISHED[name].keys())


@pytest.mark.parametrize(
    ("name", "enum", "values"),
    [
        (
            "PackedElementField",
            "NumericType",
            "UNKNOWN UINT8 INT8 UINT16 INT16 UINT32 INT32 FLOAT32 FLOAT64",
        ),
        ("PointsAnnotation", "Type", "UNKNOWN POINTS LINE_LOOP LINE_STRIP LINE_LIST"),
    ],
)
def test_the_enumerations_are_foxgloves(name: str, enum: str, values: str) -> None:
    kind = foreign(name).DESCRIPTOR.fields_by_name["type"].enum_type  # type: ignore[attr-defined]
    assert kind.full_name == f"foxglove.{name}.{enum}"
    assert [value.name for value in kind.values] == values.split()


def test_another_program_reads_what_we_write() -> None:
    image = foxglove.new("CompressedImage")
    foxglove.put_times(image, Message.at(1_500_000_001, None, begin=1_400_000_000))
    image.frame_id, image.format, image.data = "rgb", "png", b"\x01\x02"
    read = foreign("CompressedImage").FromString(image.SerializeToString())  # type: ignore[attr-defined]
    assert (read.frame_id, read.format, read.data) == ("rgb", "png", b"\x01\x02")
    assert (read.timestamp.seconds, read.timestamp.nanos) == (1, 500_000_001)


@pytest.mark.parametrize("stamp", [0, 1, 999_999_999, 10**18, -1, -1_500_000_000])
def test_times_come_back_to_the_nanosecond(stamp: int) -> None:
    image = foxglove.new("CompressedImage")
    foxglove.put_times(image, Message.at(stamp, None, begin=stamp - 5, end=stamp + 70_000_000))
    again = foxglove.parse("CompressedImage", image.SerializeToString())
    assert foxglove.times(again) == (stamp, stamp - 5, stamp + 70_000_000)


def test_bytes_that_are_no_message_are_refused() -> None:
    with pytest.raises(ValueError, match=r"not a foxglove\.PointCloud"):
        foxglove.parse("PointCloud", b"\xff\xff\xff\xff")
