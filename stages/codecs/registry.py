"""Which codec writes which payload, and which one reads a recorded topic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from pipeline.errors import DataError
from pipeline.recording.codec import PAYLOAD, PAYLOAD_CLASS, Codec
from pipeline.transport.schema import class_name
from stages.codecs.boxes import DetectionsCodec
from stages.codecs.clouds import ScanCodec, VoxelsCodec
from stages.codecs.images import DepthCodec, ImageCodec, LabelsCodec
from stages.codecs.labeled_clouds import LabeledCloudCodec, shown_cloud, shown_map
from stages.codecs.plain import PlainCodec
from stages.codecs.poses import PoseCodec
from stages.codecs.raw_images import RawDepthCodec, RawImageCodec
from stages.fused import FusedImage
from stages.labels import LabeledVoxels, Labels
from stages.types import (
    ClassScores,
    Cloud,
    DepthImage,
    Detections,
    Image,
    Pose,
    Scan,
    SemanticVoxels,
)

#: By payload type. A file names the type, never the code that reads it: a recording from a stranger
#: must not decide what is imported.
CODECS: Mapping[type, Codec] = {
    Image: ImageCodec(),
    DepthImage: DepthCodec(),
    Labels: LabelsCodec(),
    Scan: ScanCodec(),
    LabeledVoxels: VoxelsCodec(),
    Cloud: LabeledCloudCodec(Cloud, shown_cloud),
    SemanticVoxels: LabeledCloudCodec(SemanticVoxels, shown_map),
    Pose: PoseCodec(),
    Detections: DetectionsCodec(),
}

#: Those that keep every bit, where `CODECS` trades bits or time for size.
LOSSLESS: Mapping[type, Codec] = {
    **CODECS,
    Image: RawImageCodec(),
    DepthImage: RawDepthCodec(),
}

#: Payloads of ours that may lie in a file as they are, and plain values.
PLAIN = (
    *(ClassScores, Cloud, FusedImage, SemanticVoxels),
    *(bool, int, float, str, bytes, tuple, list, dict, np.ndarray),
)

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
    if schema == "overflight.Payload":
        return PayloadCodecs().reading(schema, metadata)
    named = metadata.get(PAYLOAD)
    foreign = _BY_SCHEMA.get(schema)
    for known in (CODECS, LOSSLESS):
        for payload, codec in known.items():
            ours = payload.__name__ == named if named else payload is foreign
            if ours and codec.schema.name == schema:
                return codec
    return None


class PayloadCodecs:
    """The codecs as a recorder and a replay ask for them: what viewers show as they show it, any
    other payload of dataclasses and arrays plainly. All keep every bit.

    `payloads` are those that may be read beside the project's own: a graph's custom ones.
    """

    def __init__(self, payloads: Iterable[type] = ()) -> None:
        self._plain = {class_name(payload): payload for payload in (*PLAIN, *payloads)}
        self._made: dict[type, Codec] = {}

    @staticmethod
    def known(payload: type) -> bool:
        """Whether it is read without being named."""
        return payload in LOSSLESS or payload in PLAIN

    def writing(self, payload: object) -> Codec:
        kind = type(payload)
        return LOSSLESS[kind] if kind in LOSSLESS else self._of(kind)

    def reading(self, schema: str, metadata: Mapping[str, str]) -> Codec | None:
        named = self._plain.get(metadata.get(PAYLOAD_CLASS, ""))
        if schema == "overflight.Payload":
            return None if named is None else self._of(named)
        return codec_for(schema, metadata)

    def _of(self, payload: type) -> Codec:
        codec = self._made.get(payload)
        if codec is None:
            codec = self._made[payload] = PlainCodec(payload)
        return codec
