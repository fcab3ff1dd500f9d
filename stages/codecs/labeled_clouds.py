"""Clouds and maps with class evidence: bit by bit, beside a cloud of points that viewers color.

A viewer sees x, y, z, the likeliest class and its color; what is read back is the payload as it
was.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.codecs.clouds import pack_points
from stages.codecs.plain import PlainCodec
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, SemanticVoxels

#: The label of what no source said anything of, and its color.
UNLABELED, GRAY = 255, 128


class LabeledCloudCodec:
    """The codec of one kind of payload; `shown` gives its points (n, 3), log scores (n, channels),
    which of them have evidence (n,), and their frame."""

    def __init__(
        self,
        payload: type,
        shown: Callable[[Any], tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_], str]],
    ) -> None:
        self._plain = PlainCodec(payload)
        self._shown = shown

    @property
    def schema(self) -> Schema:
        return foxglove.schema("PointCloud")

    def encode(self, message: Message[Any]) -> bytes:
        points, log_scores, evidence, frame = self._shown(message.payload)
        colors = load_taxonomy().colors
        label = log_scores[:, : len(colors)].argmax(axis=1).astype(np.uint8)
        color = colors[label]
        label[~evidence], color[~evidence] = UNLABELED, GRAY
        columns = [(name, points[:, axis]) for axis, name in enumerate("xyz")]
        columns.append(("label", label))
        columns += [(name, color[:, axis]) for axis, name in enumerate(("red", "green", "blue"))]
        columns.append(("alpha", np.full(len(label), 255, np.uint8)))
        whole = self._plain.encode(message)
        return pack_points(foxglove.new("PointCloud"), message, frame, columns, whole)

    def decode(self, data: bytes, received: int) -> Message[Any]:
        try:
            proto = foxglove.parse("PointCloud", data)
        except ValueError as error:
            raise DataError(f"damaged point cloud ({error})") from error
        return self._plain.decode(proto.payload, received)


def shown_cloud(cloud: Cloud) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_], str]:
    """A cloud as it is, in its sensor's frame."""
    return cloud.points, cloud.log_scores, cloud.evidence, cloud.sensor


def shown_map(voxels: SemanticVoxels) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_], str]:
    """A map by the mean points of its voxels, in the map frame."""
    said = np.ones(len(voxels.positions), np.bool_)
    return voxels.positions, voxels.log_scores, said, "map"
