"""Images and depth as plain pixels: lossless, and quicker than any picture format in flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.types import DepthImage, Image

#: ROS's names of pixel formats, which the viewers know: dtype and channels.
_ENCODINGS: Mapping[str, tuple[np.dtype[Any], int]] = {
    "rgb8": (np.dtype("u1"), 3),
    "mono8": (np.dtype("u1"), 1),
    "mono16": (np.dtype("<u2"), 1),
    "16UC1": (np.dtype("<u2"), 1),
}


class _RawPixels:
    """What the codecs of this file share."""

    @property
    def schema(self) -> Schema:
        return foxglove.schema("RawImage")

    def _encode(
        self,
        message: Message[Any],
        pixels: NDArray[Any],
        encoding: str,
        frame: str,
        unit_m: float = 0,
    ) -> bytes:
        dtype, channels = _ENCODINGS[encoding]
        proto = foxglove.new("RawImage")
        foxglove.put_times(proto, message)
        proto.height, proto.width = pixels.shape[:2]
        proto.encoding, proto.frame_id, proto.unit_m = encoding, frame, unit_m
        proto.step = proto.width * channels * dtype.itemsize
        return foxglove.with_data(proto, np.ascontiguousarray(pixels, dtype))

    def _decode(self, data: bytes) -> tuple[Any, NDArray[Any]]:
        try:
            proto = foxglove.parse("RawImage", data)
            dtype, channels = _ENCODINGS[proto.encoding]
        except ValueError as error:
            raise DataError(f"damaged image ({error})") from error
        except KeyError:
            known = ", ".join(_ENCODINGS)
            raise DataError(f"an image of '{proto.encoding}'; known: {known}") from None
        width, height = int(proto.width), int(proto.height)
        row = width * channels * dtype.itemsize
        if proto.step != row or len(proto.data) != row * height:
            raise DataError(f"damaged image: {len(proto.data)} bytes are not {width} x {height}")
        pixels = np.frombuffer(proto.data, dtype)  # read-only, as bytes are
        return proto, pixels.reshape((height, width, 3) if channels == 3 else (height, width))


class RawImageCodec(_RawPixels):
    """Color and gray of 8 or 16 bit."""

    def encode(self, message: Message[Image]) -> bytes:
        image = message.payload
        color = image.data.ndim == 3
        encoding = "rgb8" if color else "mono8" if image.data.dtype == np.uint8 else "mono16"
        return self._encode(message, image.data, encoding, image.camera)

    def decode(self, data: bytes, received: int) -> Message[Image]:
        proto, pixels = self._decode(data)
        return _message(proto, received, Image(pixels, proto.frame_id))


class RawDepthCodec(_RawPixels):
    """Depth of 16 bit."""

    def encode(self, message: Message[DepthImage]) -> bytes:
        image = message.payload
        return self._encode(message, image.depth, "16UC1", image.camera, image.unit_m)

    def decode(self, data: bytes, received: int) -> Message[DepthImage]:
        proto, pixels = self._decode(data)
        if pixels.ndim != 2:
            raise DataError("damaged depth: it has colors")
        return _message(proto, received, DepthImage(pixels, proto.unit_m, proto.frame_id))


def _message(proto: Any, received: int, payload: Any) -> Message[Any]:
    stamp, begin, end = foxglove.times(proto)
    return Message.at(stamp, payload, begin=begin, end=end, received=received)
