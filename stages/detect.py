"""Objects in an image as boxes, from a detection network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.errors import ModelError
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage
from stages.camera_image import eight_bit
from stages.kernels.boxes import (
    Found,
    decode_detection_output,
    decode_fastestdet,
    decode_ssd,
    ssd_anchors,
    suppress,
    to_image,
)
from stages.kernels.network_input import fitted, in_color_order, placement
from stages.taxonomy import load_taxonomy
from stages.types import Detections, Image

#: Narrower or lower boxes are cut off at the image's edge or noise.
MIN_SIZE_PX = 2.0


class DetectObjects(ModelStage):
    """Boxes in full-resolution pixels, in the classes of the taxonomy, best first.

    Heads: `detection_output`, `fastestdet`, `ssd`. A class that the model's class map leaves out is
    dropped. Boxes of one of *our* classes that overlap by more than `max_iou` count once, so that a
    car which is also found as a truck is one vehicle.
    """

    stateless = True

    def __init__(
        self, *, min_score: float = 0.4, max_iou: float = 0.5, max_boxes: int = 100
    ) -> None:
        if not 0 < min_score <= 1 or not 0 < max_iou <= 1:
            raise ValueError("min_score and max_iou must be above 0 and at most 1")
        if max_boxes < 1:
            raise ValueError(f"max_boxes must be at least 1, not {max_boxes}")
        self.min_score = min_score
        self.max_iou = max_iou
        self.max_boxes = max_boxes

    def open(self) -> None:
        head = self.model.head
        self._decode = self._decoder()
        self._letterbox = bool(head.get("letterbox", False))
        height, width, _ = self.model.input_shape
        self._picture = (width, height)
        taxonomy = load_taxonomy()
        ours = np.full(1 + max(head["class_map"], default=0), -1, dtype=np.int64)
        try:
            for theirs, name in head["class_map"].items():
                ours[theirs] = taxonomy.id(name)
        except ValueError as error:
            raise ModelError(f"model '{self.model.name}': class_map: {error}") from None
        self._ours = ours
        # Compiles the kernel (or loads it from the cache) now, not during the first frame.
        nothing = np.zeros((0, 4), np.float32), np.zeros(0, np.int64), np.zeros(0, np.float32)
        suppress(*nothing, self.max_iou)

    def prepare(self, image: Message[Image]) -> Tensors:
        pixels = eight_bit(image.payload)
        picture = fitted(pixels, self._picture, letterbox=self._letterbox)
        return {self.model.input_name: Tensor(in_color_order(picture, self.model.color)[None])}

    def finish(self, outputs: Tensors, image: Message[Image]) -> Detections:
        boxes, theirs, scores = self._decode(outputs)
        known = (theirs >= 0) & (theirs < len(self._ours))
        classes = np.where(known, self._ours[np.where(known, theirs, 0)], -1)

        size = (image.payload.data.shape[1], image.payload.data.shape[0])
        where = placement(size, self._picture, letterbox=self._letterbox)
        boxes = to_image(boxes, self._picture, where, size)
        large = (boxes[:, 2:] - boxes[:, :2] >= MIN_SIZE_PX).all(axis=1)

        keep = large & (classes >= 0)
        boxes, classes, scores = boxes[keep], classes[keep], scores[keep]
        best = suppress(boxes, classes, scores, self.max_iou)[: self.max_boxes]
        return Detections(boxes[best], classes[best], scores[best], image.payload.camera)

    def _decoder(self) -> Callable[[Tensors], Found]:
        """What reads the outputs of the model's kind of head."""
        head = self.model.head
        if head["kind"] == "detection_output":
            return lambda outputs: decode_detection_output(
                outputs["detections"].values().reshape(-1, 7), self.min_score
            )
        if head["kind"] == "fastestdet":
            return lambda outputs: decode_fastestdet(outputs["grid"].values()[0], self.min_score)
        if head["kind"] == "ssd":
            anchors = ssd_anchors(head["maps"], head["scales"])
            return lambda outputs: decode_ssd(
                outputs["boxes"].values().reshape(-1, 4),
                outputs["scores"].values()[0],
                anchors,
                self.min_score,
            )
        raise ModelError(
            f"model '{self.model.name}' has a head of kind '{head['kind']}'; "
            "DetectObjects takes 'detection_output', 'fastestdet' or 'ssd'"
        )
