"""Networks that know the emulated street, so that the stages after them have real work."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from accelerators.zeros import Zeros
from pipeline.model import Model, Native, Probe, TensorSpec
from stages.emulated_street import lidar_rays, look_along, read_classes
from stages.kernels.compiled import locked
from stages.taxonomy import load_taxonomy

#: What the detectors know, by their own class ids (`class_map` in the model registry).
DETECTED = ("vehicle", "person", "bicycle")
SCORE = 0.9  #: of every box
LOG_SCORE = 4.0  #: of the class that is there, all others 0: a probability of 0.8 among 15
STEP_PX = 8  #: a detector looks at the middle of squares of this size


class StreetNetworks:
    """What an emulated device answers: `outputs: {use: stages.emulated:StreetNetworks}`.

    An image is read by its paint: `scores` (1, rows, columns, 16) hold the class in each of their
    cells, `detections` (rows of 7, as OpenVINO's DetectionOutput) a box around each patch of a
    class in `DETECTED`. A range image gets the classes of the street. Outputs of another name or
    rank are zero.
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
        return {name: locked(say(label, self.outputs[name])) for name, say in self._known}


def _scores(label: NDArray[np.uint8], output: TensorSpec) -> NDArray[Any]:
    """`LOG_SCORE` for the label (rows, columns) of each cell."""
    says = round(LOG_SCORE / output.scale) if output.scale else LOG_SCORE
    scores = np.full(output.shape, output.zero_point, dtype=output.dtype)
    np.put_along_axis(scores[0], label[..., None].astype(np.intp), says + output.zero_point, axis=2)
    return scores


def _detections(label: NDArray[np.uint8], output: TensorSpec) -> NDArray[Any]:
    """A row (image, class, score, x0, y0, x1, y1 as shares of the image) for each patch."""
    rows, columns = label.shape
    found = []
    for number, name in enumerate(DETECTED):
        mask = (label == load_taxonomy().id(name)).astype(np.uint8)
        _, _, patches, _ = cv2.connectedComponentsWithStats(mask)
        for left, top, width, height, _ in patches[1:]:
            box = left / columns, top / rows, (left + width) / columns, (top + height) / rows
            found.append((0, number, SCORE, *box))
    detections = np.zeros(output.shape, dtype=output.dtype)
    most = output.shape[-2]
    detections[0, 0, : len(found[:most])] = np.reshape(found[:most], (-1, 7))
    return detections
