"""Networks that know the emulated street, so that the stages after them have real work."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from accelerators.zeros import Zeros
from pipeline.model import Model, Native, Probe, TensorSpec
from stages.emulated_street import lidar_rays, look_along, read_classes
from stages.kernels.anchors import CODER, SMALL_OBJECTS, multiscale_anchors
from stages.kernels.compiled import locked
from stages.kernels.scores import logit
from stages.taxonomy import load_taxonomy

#: What the detectors know, by their own class ids (`class_map` in the model registry): those that
#: list detections, and those that mark centers or move anchors.
DETECTED = ("vehicle", "person", "bicycle")
CENTERED = ("person", "vehicle", "bicycle")
SCORE = 0.9  #: of every box
LOG_SCORE = 4.0  #: of the class that is there, all others 0: a probability of 0.8 among 15
_CENTERS = ("heat", "size", "offset")
_ANCHORED = ("boxes", "scores")
STEP_PX = 8  #: a detector looks at the middle of squares of this size


class StreetNetworks:
    """What an emulated device answers: `outputs: {use: stages.emulated:StreetNetworks}`.

    An image is read by its paint: `scores` (1, rows, columns, 16) hold the class in each of their
    cells, `detections` (rows of 7, as OpenVINO's DetectionOutput) a box around each patch of a
    class in `DETECTED`; `heat`, `size` and `offset` mark the center of each in `CENTERED`, as a
    CenterNet with logarithmic sizes and cells centered at 0.5; `boxes` and `scores` (1, anchors, k)
    box it, as an SSD with the anchors `SMALL_OBJECTS`. A range image gets the classes of the
    street. Outputs of another name or shape are zero.
    """

    kinds: tuple[str, ...] = ("emulated",)

    def probe(self) -> Probe:
        return Probe(True, "the emulated street", "what is painted there")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        return _Network(Zeros(variant))

    def close(self) -> None:
        """Nothing is held."""


class _Network:
    """One image in, scores or detections out."""

    def __init__(self, zeros: Model) -> None:
        self._zeros = zeros
        self.inputs, self.outputs = zeros.inputs, zeros.outputs
        self._name, image = next(iter(self.inputs.items()))
        _, height, width, channels = image.shape
        self._known = [
            (name, say)
            for name, say in (("scores", _scores), ("detections", _detections))
            if name in self.outputs and len(self.outputs[name].shape) == 4
        ]
        if ("scores", _scores) in self._known:
            _, rows, columns, _ = self.outputs["scores"].shape
            self._rows = np.rint(np.linspace(0, height - 1, rows)).astype(np.int64)[:, None]
            self._columns = np.rint(np.linspace(0, width - 1, columns)).astype(np.int64)
        else:
            self._rows = np.arange(STEP_PX // 2, height, STEP_PX)[:, None]
            self._columns = np.arange(STEP_PX // 2, width, STEP_PX)
        self._anchors: _Anchors | None = None
        if set(_ANCHORED) <= self.outputs.keys():
            anchors = multiscale_anchors(*SMALL_OBJECTS, (width, height))
            if all(self.outputs[name].shape[1] == len(anchors) for name in _ANCHORED):
                self._anchors = _Anchors(anchors)
        self._scan: Native = {}  #: the answer to a range image, which has no paint
        if channels > 3:
            self._scan = self._answer(look_along(lidar_rays(height, width), np.eye(4)).label)

    def infer(self, inputs: Native) -> Native:
        answer = {**self._zeros.infer(inputs), **self._scan}
        if not self._scan:
            paint = inputs[self._name][0, self._rows, self._columns]
            answer |= self._answer(read_classes(paint))
        return answer

    def _answer(self, label: NDArray[np.uint8]) -> Native:
        answer = {name: locked(say(label, self.outputs[name])) for name, say in self._known}
        if set(_CENTERS) <= self.outputs.keys():
            answer |= _centers(label, self.outputs)
        if self._anchors is not None:
            answer |= _moved_anchors(label, self.outputs, self._anchors)
        return answer


def _scores(label: NDArray[np.uint8], output: TensorSpec) -> NDArray[Any]:
    """`LOG_SCORE` for the label (rows, columns) of each cell."""
    says = round(LOG_SCORE / output.scale) if output.scale else LOG_SCORE
    scores = np.full(output.shape, output.zero_point, dtype=output.dtype)
    np.put_along_axis(scores[0], label[..., None].astype(np.intp), says + output.zero_point, axis=2)
    return scores


def _detections(label: NDArray[np.uint8], output: TensorSpec) -> NDArray[Any]:
    """A row (image, class, score, x0, y0, x1, y1 as shares of the image) for each patch."""
    found = [(0, number, SCORE, *box) for number, box in _patches(label, DETECTED)]
    detections = np.zeros(output.shape, dtype=output.dtype)
    most = output.shape[-2]
    detections[0, 0, : len(found[:most])] = np.reshape(found[:most], (-1, 7))
    return detections


def _centers(label: NDArray[np.uint8], outputs: Mapping[str, TensorSpec]) -> Native:
    """Heat, size and offset (1, rows, columns, k) in cells; the last two are not quantized."""
    heat, size, offset = (np.zeros(outputs[name].shape, outputs[name].dtype) for name in _CENTERS)
    form = outputs["heat"]
    _, rows, columns, _ = form.shape
    for number, box in _patches(label, CENTERED):
        x0, y0, x1, y1 = np.array(box) * (columns, rows, columns, rows)
        column, row = int((x0 + x1) / 2), int((y0 + y1) / 2)
        heat[0, row, column, number] = _stored(SCORE, form)
        size[0, row, column] = np.log([x1 - x0, y1 - y0])
        offset[0, row, column] = (x0 + x1) / 2 - column - 0.5, (y0 + y1) / 2 - row - 0.5
    return {name: locked(one) for name, one in zip(_CENTERS, (heat, size, offset), strict=True)}


def _stored(score: float, form: TensorSpec) -> int:
    """A score as the quantized logit of an output."""
    return round(logit(score) / form.scale) + form.zero_point


class _Anchors:
    """Anchors (n, 4), center y x height width, by their forms: there are few of those."""

    def __init__(self, anchors: NDArray[np.float32]) -> None:
        self._anchors = anchors
        self._forms, form = np.unique(anchors[:, 2:], axis=0, return_inverse=True)
        self._of_form = [np.flatnonzero(form == k) for k in range(len(self._forms))]

    def moved(self, box: NDArray[np.float64]) -> tuple[int, NDArray[np.float64]]:
        """The nearest of those of the box's size, and its regressions ty tx th tw to the box."""
        form = int(np.argmin((np.log(box[2:] / self._forms) ** 2).sum(axis=1)))
        among = self._of_form[form]
        away = (box[:2] - self._anchors[among, :2]) / self._forms[form]
        nearest = int(np.argmin((away**2).sum(axis=1)))
        moves = np.concatenate([away[nearest], np.log(box[2:] / self._forms[form])])
        return int(among[nearest]), moves * CODER


def _moved_anchors(
    label: NDArray[np.uint8], outputs: Mapping[str, TensorSpec], anchors: _Anchors
) -> Native:
    """Boxes (1, anchors, 4), not quantized, and scores (1, anchors, classes): an anchor for each
    patch."""
    boxes, scores = (np.zeros(outputs[name].shape, outputs[name].dtype) for name in _ANCHORED)
    form = outputs["scores"]
    for number, (x0, y0, x1, y1) in _patches(label, CENTERED):
        box = np.array([(y0 + y1) / 2, (x0 + x1) / 2, y1 - y0, x1 - x0])
        anchor, boxes[0, anchor] = anchors.moved(box)
        scores[0, anchor, number] = _stored(SCORE, form)
    return {name: locked(one) for name, one in zip(_ANCHORED, (boxes, scores), strict=True)}


def _patches(
    label: NDArray[np.uint8], names: Sequence[str]
) -> Iterator[tuple[int, tuple[float, float, float, float]]]:
    """The class, as its place in `names`, and the box x0 y0 x1 y1 of each patch, as shares."""
    rows, columns = label.shape
    for number, name in enumerate(names):
        mask = (label == load_taxonomy().id(name)).astype(np.uint8)
        _, _, patches, _ = cv2.connectedComponentsWithStats(mask)
        for left, top, width, height, _ in patches[1:]:
            box = left / columns, top / rows, (left + width) / columns, (top + height) / rows
            yield number, box
