"""Which codec writes which payload, and which one reads a recorded topic."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.errors import DataError
from pipeline.recording.codec import Codec
from pipeline.recording.mcap import Channel
from stages.codecs.boxes import DetectionsCodec
from stages.codecs.clouds import ScanCodec, VoxelsCodec
from stages.codecs.images import DepthCodec, ImageCodec, LabelsCodec
from stages.codecs.poses import PoseCodec
from stages.labels import LabeledVoxels, Labels
from stages.types import DepthImage, Detections, Image, Pose, Scan

#: By payload type. A file names the type, never the code that reads it: a recording from a stranger
#: must not decide what is imported.
CODECS: Mapping[type, Codec] = {
    Image: ImageCodec(),
    DepthImage: DepthCodec(),
    Labels: LabelsCodec(),
    Scan: ScanCodec(),
    LabeledVoxels: VoxelsCodec(),
    Pose: PoseCodec(),
    Detections: DetectionsCodec(),
}

#: The key of a channel's metadata that names the payload type.
PAYLOAD = "payload"

#: What a topic of another program is taken for, by its schema.
_BY_SCHEMA = {
    "foxglove.CompressedImage": Image,
    "foxglove.PointCloud": Scan,
    "foxglove.FrameTransform": Pose,
    "foxglove.ImageAnnotations": Detections,
}


def codec_of(payload: object) -> Codec:
    """The codec that writes a payload. Raises DataError where there is none."""
    try:
        return CODECS[type(payload)]
    except KeyError:
        raise DataError(f"no codec writes {type(payload).__name__} to a recording") from None


def codec_for(channel: Channel) -> Codec | None:
    """The codec that reads a topic's messages; None where they are no payload of ours."""
    named = channel.metadata.get(PAYLOAD)
    for payload, codec in CODECS.items():
        if payload.__name__ == named:
            return codec
    payload_type = None if named else _BY_SCHEMA.get(channel.schema)
    return CODECS[payload_type] if payload_type else None
