"""Every payload comes back from a recording as it went in, and damaged bytes are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import PAYLOAD
from stages.codecs.poses import (
    decode_calibration,
    encode_camera,
    encode_mounts,
    quaternion_from_rotation,
)
from stages.codecs.registry import CODECS, codec_for, codec_of
from stages.kernels.geometry import rotation_exp, rotation_from_quaternion
from stages.labels import LabeledVoxels, Labels
from stages.taxonomy import load_taxonomy
from stages.types import (
    CHANNELS,
    Calibration,
    Camera,
    Cloud,
    DepthImage,
    Detections,
    Image,
    Pose,
    Scan,
    SemanticVoxels,
    SensorCalibration,
)

RANDOM = np.random.default_rng(5)


def pose(*vector: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_exp(np.array(vector))
    matrix[:3, 3] = 1.0, -2.0, 3.0
    return matrix


def scan(*, organized: bool, eight_bit: bool, own_times: bool) -> Scan:
    remission = RANDOM.random(24, dtype=np.float32)
    if eight_bit:
        remission = np.round(remission * 255) / np.float32(255)
    times = RANDOM.integers(-9, 9, 24) if own_times else np.tile(np.arange(6) * 100 - 250, 4)
    return Scan(
        points=RANDOM.normal(0, 9, (24, 3)).astype(np.float32),
        remission=remission.astype(np.float32),
        times_ns=times.astype(np.int32),
        shape=(4, 6) if organized else None,
        sensor="lidar",
    )


def scores(count: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    return RANDOM.normal(-2, 1, (count, CHANNELS)).astype(np.float32)


PAYLOADS = [
    Cloud(
        RANDOM.normal(0, 9, (24, 3)).astype(np.float32),
        scores(24),
        RANDOM.random(24) < 0.5,
        pose(0.1, 0.2, 0.3),
        "lidar",
        times_ns=np.arange(24, dtype=np.int32),
        shape=(4, 6),
    ),
    SemanticVoxels(
        0.25,
        RANDOM.integers(-9, 9, (7, 3)).astype(np.int32),
        RANDOM.normal(0, 2, (7, 3)).astype(np.float32),
        scores(7),
        np.arange(7, dtype=np.int32),
    ),
    Image(RANDOM.integers(0, 65536, (12, 17)).astype(np.uint16), "thermal"),
    Image(RANDOM.integers(0, 256, (12, 17)).astype(np.uint8), "gray"),
    DepthImage(RANDOM.integers(0, 20000, (9, 11)).astype(np.uint16), 0.001, "rgb"),
    Labels(
        RANDOM.integers(0, 15, (9, 11)).astype(np.uint8),
        RANDOM.integers(0, 65536, (9, 11)).astype(np.uint16),
        "rgb",
    ),
    scan(organized=True, eight_bit=True, own_times=False),
    scan(organized=True, eight_bit=False, own_times=True),
    scan(organized=False, eight_bit=False, own_times=True),
    Scan(np.zeros((0, 3), dtype=np.float32), None, None, None, "lidar"),
    LabeledVoxels(
        0.25,
        RANDOM.integers(-900, 900, (30, 3)).astype(np.int32),
        RANDOM.integers(0, 15, 30).astype(np.uint8),
    ),
    LabeledVoxels(0.1, np.array([[-1, 0, 4000]], dtype=np.int32), np.array([3], dtype=np.uint8)),
    Pose(pose(0.3, -0.2, 2.9)),
    Detections(
        RANDOM.random((3, 4)).astype(np.float32) * 99,
        np.array([5, 13, 11]),
        RANDOM.random(3).astype(np.float32),
        "rgb",
    ),
    Detections(np.zeros((0, 4), np.float32), np.zeros(0, np.int64), np.zeros(0, np.float32), "x"),
]


def same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    for name in a.__dataclass_fields__:
        one, two = getattr(a, name), getattr(b, name)
        if isinstance(one, np.ndarray) and one.dtype == np.float64:
            assert two == pytest.approx(one, abs=1e-12)
        elif isinstance(one, np.ndarray):
            assert one.dtype == two.dtype
            assert one.shape == two.shape
            assert np.array_equal(one, two)
            assert not two.flags.writeable
        else:
            assert one == two


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda payload: type(payload).__name__)
def test_a_payload_comes_back_as_it_went_in(payload: Any) -> None:
    codec = codec_of(payload)
    sent = Message.at(1_234_567_890, payload, begin=1_200_000_000, end=1_300_000_000)
    read = codec.decode(codec.encode(sent), received=1_400_000_000)
    same(payload, read.payload)
    assert (read.stamp, read.begin, read.end) == (sent.stamp, sent.begin, sent.end)
    assert read.received == 1_400_000_000


def test_a_color_image_comes_back_nearly_and_in_its_own_colors() -> None:
    data = np.empty((64, 64, 3), dtype=np.uint8)
    data[:] = 200, 60, 20
    data[:, 32:] = 20, 60, 200
    codec = codec_of(Image(data, "rgb"))
    read = codec.decode(codec.encode(Message.at(0, Image(data, "rgb"))), 0).payload
    assert np.abs(read.data.astype(int) - data).mean() < 3
    assert not read.data.flags.writeable


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda payload: type(payload).__name__)
@given(data=st.data())
def test_damaged_bytes_are_refused_or_read_but_never_crash(payload: Any, data: Any) -> None:
    codec = codec_of(payload)
    good = codec.encode(Message.at(5, payload))
    place = data.draw(st.integers(0, len(good) - 1))
    changed = bytearray(good[: data.draw(st.integers(place + 1, len(good)))])
    changed[place] ^= data.draw(st.integers(1, 255))
    try:
        read = codec.decode(bytes(changed), 5)
    except DataError:
        return
    assert type(read.payload) is type(payload)


@given(st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3))
def test_rotations_survive_as_quaternions(vector: list[float]) -> None:
    rotation = rotation_exp(np.array(vector))
    quaternion = quaternion_from_rotation(rotation)
    assert rotation_from_quaternion(quaternion) == pytest.approx(rotation, abs=1e-9)
    assert quaternion[3] >= 0


def test_a_calibration_comes_back() -> None:
    camera = Camera((848, 480), 424.0, 425.0, 423.5, 239.5, (0.1, -0.05, 0.001, 0.002, 0.01))
    calibration = Calibration(
        {
            "rgb": SensorCalibration(pose(0.1, 0.2, 0.3), camera),
            "lidar": SensorCalibration(pose(0.0, 0.0, 3.0)),
        }
    )
    read = decode_calibration(encode_mounts(calibration, 0), [encode_camera("rgb", camera, 0)])
    assert read.camera("rgb") == camera
    assert read.cameras() == ("rgb",)
    for name, sensor in calibration.sensors.items():
        same_pose = read.sensor(name).base_from_sensor
        assert same_pose == pytest.approx(sensor.base_from_sensor, abs=1e-12)


def test_a_topic_is_read_by_the_payload_it_names_else_by_its_schema() -> None:
    def codec(schema: str, **metadata: str) -> object:
        return codec_for(schema, metadata)

    assert codec("foxglove.CompressedImage", **{PAYLOAD: "Labels"}) is CODECS[Labels]
    assert codec("foxglove.PointCloud") is CODECS[Scan]
    assert codec("foxglove.PointCloud", **{PAYLOAD: "os.system"}) is None
    assert codec("foxglove.Log") is None


def test_a_payload_without_a_codec_is_named() -> None:
    with pytest.raises(DataError, match="no codec writes Calibration"):
        codec_of(Calibration())


def test_a_viewer_sees_the_points_of_a_cloud_in_the_colors_of_their_classes() -> None:
    cloud = PAYLOADS[0]
    assert isinstance(cloud, Cloud)
    data = CODECS[Cloud].encode(Message.at(5, cloud))
    shown = foxglove.parse("PointCloud", data)
    kinds = {number: kind for kind, number in foxglove.NUMERIC.items()}
    names = [field.name for field in shown.fields]
    assert names == ["x", "y", "z", "label", "red", "green", "blue", "alpha"]
    table = np.frombuffer(shown.data, np.dtype([(f.name, kinds[f.type]) for f in shown.fields]))
    assert np.array_equal(np.stack([table[axis] for axis in "xyz"], axis=1), cloud.points)
    colors = load_taxonomy().colors
    label = cloud.log_scores[:, : len(colors)].argmax(axis=1)
    assert np.array_equal(table["label"], np.where(cloud.evidence, label, 255))
    assert np.array_equal(table["red"], np.where(cloud.evidence, colors[label, 0], 128))
