"""Images, depth and labels as compressed pictures that any viewer opens."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.labels import Labels
from stages.types import DepthImage, Image

#: 117 kB for a frame of 848 x 480; at 80 it is 74 kB and shows in the networks' edges.
JPEG_QUALITY = 90
#: PNG's fastest level: a frame of depth takes 8 ms instead of 60, and is 4 % larger.
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class _Picture:
    """What the codecs of this file share."""

    @property
    def schema(self) -> Schema:
        return foxglove.schema("CompressedImage")

    def _encode(
        self, message: Message[Any], picture: NDArray[Any], frame: str, form: str, unit_m: float = 0
    ) -> bytes:
        flags = _PNG if form == "png" else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
        good, data = cv2.imencode(f".{form}", picture, flags)
        if not good:
            raise DataError(f"{frame}: cannot compress an image of {picture.dtype} as {form}")
        proto = foxglove.new("CompressedImage")
        foxglove.put_times(proto, message)
        proto.frame_id, proto.format, proto.unit_m = frame, form, unit_m
        proto.data = data.tobytes()
        return bytes(proto.SerializeToString())

    def _decode(self, data: bytes) -> tuple[Any, NDArray[Any]]:
        try:
            proto = foxglove.parse("CompressedImage", data)
            picture = cv2.imdecode(np.frombuffer(proto.data, np.uint8), cv2.IMREAD_UNCHANGED)
        except (ValueError, cv2.error) as error:
            raise DataError(f"damaged image ({error})") from error
        if picture is None:
            raise DataError(f"damaged image: not {proto.format or 'a picture'}")
        return proto, picture


class ImageCodec(_Picture):
    """Color as JPEG (lossy), gray of 8 or 16 bit as PNG (lossless)."""

    def encode(self, message: Message[Image]) -> bytes:
        data = message.payload.data
        if data.ndim == 3:
            picture = cv2.cvtColor(data, cv2.COLOR_RGB2BGR)
            return self._encode(message, picture, message.payload.camera, "jpeg")
        return self._encode(message, data, message.payload.camera, "png")

    def decode(self, data: bytes, received: int) -> Message[Image]:
        proto, picture = self._decode(data)
        if picture.ndim == 3:
            picture = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        return _message(proto, received, Image(_locked(picture), proto.frame_id))


class DepthCodec(_Picture):
    """Depth as 16-bit PNG."""

    def encode(self, message: Message[DepthImage]) -> bytes:
        image = message.payload
        return self._encode(message, image.depth, image.camera, "png", image.unit_m)

    def decode(self, data: bytes, received: int) -> Message[DepthImage]:
        proto, picture = self._decode(data)
        return _message(proto, received, DepthImage(_locked(picture), proto.unit_m, proto.frame_id))


class LabelsCodec(_Picture):
    """Class in the red channel of a PNG, the instance's low and high byte in green and blue."""

    def encode(self, message: Message[Labels]) -> bytes:
        labels = message.payload
        low, high = labels.instances & 0xFF, labels.instances >> 8
        picture = cv2.merge([high.astype(np.uint8), low.astype(np.uint8), labels.classes])
        return self._encode(message, picture, labels.sensor, "png")

    def decode(self, data: bytes, received: int) -> Message[Labels]:
        proto, picture = self._decode(data)
        high, low, classes = cv2.split(picture)
        instances = high.astype(np.uint16) << 8 | low
        return _message(
            proto, received, Labels(_locked(classes), _locked(instances), proto.frame_id)
        )


def _message(proto: Any, received: int, payload: Any) -> Message[Any]:
    stamp, begin, end = foxglove.times(proto)
    return Message.at(stamp, payload, begin=begin, end=end, received=received)


def _locked(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
