"""Poses as frame transforms, and a calibration as camera models and fixed transforms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.kernels.geometry import rotation_from_quaternion
from stages.types import Calibration, Camera, Pose, SensorCalibration

MAP, BASE = "map", "base"


class PoseCodec:
    """The vehicle's pose as the transform from `base` to `map`; its matrix beside it, lossless."""

    def __init__(self, child: str = BASE) -> None:
        """`child` names the frame: the truth must not move the vehicle that a viewer shows."""
        self._child = child

    @property
    def schema(self) -> Schema:
        return foxglove.schema("FrameTransform")

    def encode(self, message: Message[Pose]) -> bytes:
        proto = foxglove.new("FrameTransform")
        _put_transform(proto, MAP, self._child, message.payload.map_from_base)
        proto.matrix.extend(message.payload.map_from_base.ravel().tolist())
        foxglove.put_times(proto, message)
        return bytes(proto.SerializeToString())

    def decode(self, data: bytes, received: int) -> Message[Pose]:
        try:
            proto = foxglove.parse("FrameTransform", data)
        except ValueError as error:
            raise DataError(f"damaged pose ({error})") from error
        pose = _matrix(proto) if proto.matrix else _transform(proto)
        pose.flags.writeable = False
        stamp, begin, end = foxglove.times(proto)
        return Message.at(stamp, Pose(pose), begin=begin, end=end, received=received)


def _matrix(proto: Any) -> NDArray[np.float64]:
    pose = np.array(proto.matrix, dtype=np.float64)
    if pose.size != 16 or not np.isfinite(pose).all():
        raise DataError(f"damaged pose: {pose.size} finite numbers are no 4 x 4 matrix")
    return pose.reshape(4, 4)


def encode_mounts(calibration: Calibration, stamp: int) -> bytes:
    """The fixed transforms from every sensor to `base`, as foxglove.FrameTransforms."""
    proto = foxglove.new("FrameTransforms")
    for name, sensor in calibration.sensors.items():
        transform = proto.transforms.add()
        foxglove.put_times(transform, Message.at(stamp, None))
        _put_transform(transform, BASE, name, sensor.base_from_sensor)
    return bytes(proto.SerializeToString())


def encode_camera(name: str, camera: Camera, stamp: int) -> bytes:
    """A camera model as foxglove.CameraCalibration."""
    proto = foxglove.new("CameraCalibration")
    foxglove.put_times(proto, Message.at(stamp, None))
    proto.frame_id = name
    proto.width, proto.height = camera.size
    proto.distortion_model = "plumb_bob"
    proto.D.extend(camera.distortion)
    proto.K.extend([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1])
    proto.R.extend(np.eye(3).ravel())
    proto.P.extend([camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0])
    return bytes(proto.SerializeToString())


def decode_calibration(mounts: bytes, cameras: list[bytes]) -> Calibration:
    """The calibration of `encode_mounts` and `encode_camera`. Raises DataError."""
    models: dict[str, Camera] = {}
    try:
        for data in cameras:
            proto = foxglove.parse("CameraCalibration", data)
            fx, _, cx, _, fy, cy, *_ = proto.K
            distortion = (*proto.D, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
            models[proto.frame_id] = Camera((proto.width, proto.height), fx, fy, cx, cy, distortion)
        transforms = foxglove.parse("FrameTransforms", mounts).transforms
    except ValueError as error:
        raise DataError(f"damaged calibration ({error})") from error
    return Calibration(
        {
            entry.child_frame_id: SensorCalibration(
                _transform(entry), models.get(entry.child_frame_id)
            )
            for entry in transforms
        }
    )


def _put_transform(proto: Any, parent: str, child: str, pose: NDArray[np.float64]) -> None:
    proto.parent_frame_id, proto.child_frame_id = parent, child
    proto.translation.x, proto.translation.y, proto.translation.z = pose[:3, 3]
    quaternion = quaternion_from_rotation(pose[:3, :3])
    proto.rotation.x, proto.rotation.y, proto.rotation.z, proto.rotation.w = quaternion


def _transform(proto: Any) -> NDArray[np.float64]:
    pose = np.eye(4)
    r, t = proto.rotation, proto.translation
    quaternion = np.array([r.x, r.y, r.z, r.w])
    pose[:3, 3] = t.x, t.y, t.z
    if not (np.abs(quaternion) < 2).all() or not 0.9 < quaternion @ quaternion < 1.1:
        raise DataError("damaged transform: its rotation is no unit quaternion")
    if not np.isfinite(pose).all():
        raise DataError("damaged transform: its translation is not finite")
    pose[:3, :3] = rotation_from_quaternion(quaternion)
    return pose


def quaternion_from_rotation(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The unit quaternion x y z w, w >= 0, of a rotation matrix (3, 3).

    The eigenvector of the greatest eigenvalue (I. Bar-Itzhack, 2000): exact also near half turns.
    """
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m.trace()],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3.0)
    quaternion = vectors[:, -1]
    return np.asarray(quaternion if quaternion[3] >= 0 else -quaternion)
