"""Objects in an image as boxes, from a detection network."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np

from pipeline.errors import ModelError
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage
from stages.camera_image import eight_bit
from stages.heads.kinds import read_head
from stages.kernels.boxes import is_finite, suppress, to_image
from stages.kernels.network_input import fitted, in_color_order, placement
from stages.taxonomy import load_taxonomy
from stages.types import Detections, Image

#: Narrower or lower boxes are cut off at the image's edge or noise.
MIN_SIZE_PX = 2.0


class DetectObjects(ModelStage):
    """Boxes in full-resolution pixels, in the classes of the taxonomy, best first.

    The model's head says what its outputs mean (`stages/heads/`). A class that its class map leaves
    out is dropped. Boxes of one of *our* classes that overlap by more than `max_iou` count once, so
    that a car which is also found as a truck is one vehicle; `max_iou: 1` keeps them all.
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
        self._broken = 0
        self._counting = threading.Lock()  # several runs may finish at once

    def open(self) -> None:
        height, width, _ = self.model.input_shape
        self._picture = (width, height)
        head = read_head(self.model)
        self._letterbox = head.letterbox
        taxonomy = load_taxonomy()
        ours = np.full(1 + max(head.class_map, default=0), -1, dtype=np.int64)
        try:
            self._decode = head.decoder(self._picture, self.min_score)
            for theirs, name in head.class_map.items():
                ours[theirs] = taxonomy.id(name)
        except ValueError as error:
            raise ModelError(f"model '{self.model.name}': class_map: {error}") from None
        self._ours = ours
        # Compiles the kernel (or loads it from the cache) now, not during the first frame.
        nothing = np.zeros((0, 4), np.float32), np.zeros(0, np.int64), np.zeros(0, np.float32)
        suppress(*nothing, self.max_iou, self.max_boxes)

    def prepare(self, image: Message[Image]) -> Tensors:
        pixels = eight_bit(image.payload)
        picture = fitted(pixels, self._picture, letterbox=self._letterbox)
        return {self.model.input_name: Tensor(in_color_order(picture, self.model.color)[None])}

    def finish(self, outputs: Tensors, image: Message[Image]) -> Detections:
        try:
            boxes, theirs, scores = self._decode(outputs)
        except ModelError as error:
            raise ModelError(f"model '{self.model.name}': {error}") from None
        finite = is_finite(boxes, scores)
        if broken := int(np.count_nonzero(~finite)):
            with self._counting:
                self._broken += broken
        known = (theirs >= 0) & (theirs < len(self._ours))
        classes = np.where(known, self._ours[np.where(known, theirs, 0)], -1)
        keep = finite & (scores >= self.min_score) & (classes >= 0)
        boxes, classes, scores = boxes[keep], classes[keep], np.minimum(scores[keep], 1.0)

        size = (image.payload.data.shape[1], image.payload.data.shape[0])
        where = placement(size, self._picture, letterbox=self._letterbox)
        boxes = to_image(boxes, self._picture, where, size)
        large = (boxes[:, 2:] - boxes[:, :2] >= MIN_SIZE_PX).all(axis=1)
        boxes, classes, scores = boxes[large], classes[large], scores[large]
        best = suppress(boxes, classes, scores, self.max_iou, self.max_boxes)
        return Detections(boxes[best], classes[best], scores[best], image.payload.camera)

    def statistics(self) -> Mapping[str, float]:
        """`broken_boxes`: dropped because the network gave NaN or infinity."""
        return {"broken_boxes": self._broken}
