"""Which codec writes which payload, and which one reads a recorded topic."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.errors import DataError
from pipeline.recording.codec import PAYLOAD, Codec
from stages.codecs.boxes import DetectionsCodec
from stages.codecs.clouds import ScanCodec, VoxelsCodec
from stages.codecs.images import DepthCodec, ImageCodec, LabelsCodec
from stages.codecs.poses import PoseCodec
from stages.codecs.raw_images import RawDepthCodec, RawImageCodec
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

#: Those that keep every bit, where `CODECS` trades bits or time for size.
LOSSLESS: Mapping[type, Codec] = {
    **CODECS,
    Image: RawImageCodec(),
    DepthImage: RawDepthCodec(),
}

#: What a topic of another program is taken for, by its schema.
_BY_SCHEMA = {
    "foxglove.RawImage": Image,
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


def codec_for(schema: str, metadata: Mapping[str, str]) -> Codec | None:
    """The codec that reads a topic's messages; None where they are no payload of ours."""
    named = metadata.get(PAYLOAD)
    foreign = _BY_SCHEMA.get(schema)
    for known in (CODECS, LOSSLESS):
        for payload, codec in known.items():
            ours = payload.__name__ == named if named else payload is foreign
            if ours and codec.schema.name == schema:
                return codec
    return None


class PayloadCodecs:
    """The codecs as a recorder and a replay ask for them."""

    def writing(self, payload: object) -> Codec:
        try:
            return LOSSLESS[type(payload)]
        except KeyError:
            raise DataError(f"no codec writes {type(payload).__name__} to a recording") from None

    def reading(self, schema: str, metadata: Mapping[str, str]) -> Codec | None:
        return codec_for(schema, metadata)
