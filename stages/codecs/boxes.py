"""Detections as image annotations: an outline and a caption each."""

from __future__ import annotations

import numpy as np

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording import foxglove
from pipeline.recording.codec import Schema
from stages.taxonomy import load_taxonomy
from stages.types import Detections


class DetectionsCodec:
    """Boxes with class and score; classes are written by name."""

    @property
    def schema(self) -> Schema:
        return foxglove.schema("ImageAnnotations")

    def encode(self, message: Message[Detections]) -> bytes:
        found, taxonomy = message.payload, load_taxonomy()
        proto = foxglove.new("ImageAnnotations")
        foxglove.put_times(proto, message)
        proto.frame_id = found.camera
        proto.scores.extend(found.scores.tolist())
        for (x0, y0, x1, y1), kind in zip(found.boxes.tolist(), found.classes, strict=True):
            outline = proto.points.add(type=foxglove.LINE_LOOP, thickness=1.5)
            caption = proto.texts.add(text=taxonomy.names[kind], font_size=10)
            caption.position.x, caption.position.y = x0, y0
            for annotation in (outline, caption):
                annotation.timestamp.CopyFrom(proto.timestamp)
            for color in (outline.outline_color, caption.text_color):
                color.r, color.g, color.b = taxonomy.colors[kind] / 255.0
                color.a = 1.0
            for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)):
                outline.points.add(x=x, y=y)
        return bytes(proto.SerializeToString())

    def decode(self, data: bytes, received: int) -> Message[Detections]:
        taxonomy = load_taxonomy()
        try:
            proto = foxglove.parse("ImageAnnotations", data)
            corners = [(box.points[0], box.points[2]) for box in proto.points]
            boxes = [(low.x, low.y, high.x, high.y) for low, high in corners]
            classes = [taxonomy.id(caption.text) for caption in proto.texts]
            if not len(boxes) == len(classes) == len(proto.scores):
                raise ValueError(f"{len(boxes)} boxes with {len(classes)} captions")
        except (ValueError, IndexError) as error:
            raise DataError(f"damaged boxes ({error})") from error
        found = Detections(
            boxes=np.array(boxes, dtype=np.float32).reshape(-1, 4),
            classes=np.array(classes, dtype=np.int64),
            scores=np.array(proto.scores, dtype=np.float32),
            camera=proto.frame_id,
        )
        for array in (found.boxes, found.classes, found.scores):
            array.flags.writeable = False
        stamp, begin, end = foxglove.times(proto)
        return Message.at(stamp, found, begin=begin, end=end, received=received)
