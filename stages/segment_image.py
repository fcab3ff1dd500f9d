"""Class scores of an image from a segmentation network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ModelError
from pipeline.message import Message
from pipeline.model import Tensor, Tensors
from pipeline.stage import ModelStage
from stages.camera_image import eight_bit
from stages.kernels.class_groups import grouped_log_scores, label_log_scores, membership
from stages.kernels.network_input import gamma_table, in_color_order
from stages.score_grid import ScoreGrid
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, PADDING_LOG, ClassScores, Image


@dataclass(frozen=True, slots=True)
class Tiling:
    """A row of `count` equal tiles of the image's full height, evenly spread from edge to edge."""

    aspect: float  #: width of a tile / height of the image
    count: int


class SegmentImage(ModelStage):
    """Class scores on the grid of the network, never enlarged to the image.

    Heads: `scores` (logits; without a class map the channels are ours and stay quantized, uncopied)
    and `label_map` (labels with a declared `confidence`, the rest spread evenly over the others).
    Where their cells lie in the image is exact, for heads with `align_corners` too: `ScoreGrid`.

    `temperature` above 1 makes an overconfident network milder. `tiles` cuts a wide image into
    tiles of about the network's aspect, each a run of the network, instead of squeezing it;
    `gammas` runs each tile in several exposures and averages the logits. With both, the public
    Cityscapes network labels KITTI's street well, which it does not on the squeezed image.
    """

    stateless = True

    def __init__(
        self,
        *,
        temperature: float = 1.0,
        tiles: Sequence[Tiling] = (),
        gammas: Sequence[float] = (1.0,),
    ) -> None:
        if not temperature > 0:
            raise ValueError(f"temperature must be above 0, not {temperature}")
        if any(not (tile.aspect > 0 and tile.count > 0) for tile in tiles):
            raise ValueError("a tile needs an aspect and a count above 0")
        if not gammas or any(not gamma > 0 for gamma in gammas):
            raise ValueError("gammas must be one or more numbers above 0")
        self.temperature = temperature
        self.tiles = tuple(tiles)
        self._gammas = [None if gamma == 1 else gamma_table(gamma) for gamma in gammas]

    def open(self) -> None:
        head = self.model.head
        if head["kind"] not in ("scores", "label_map"):
            raise ModelError(
                f"model '{self.model.name}' has a head of kind '{head['kind']}'; "
                "SegmentImage takes 'scores' or 'label_map'"
            )
        self._grid = ScoreGrid.of(self.model.input_shape, head)
        taxonomy = load_taxonomy()
        self._classes = len(taxonomy)
        try:
            self._groups = {theirs: taxonomy.id(name) for theirs, name in head["class_map"].items()}
        except ValueError as error:
            raise ModelError(f"model '{self.model.name}': class_map: {error}") from None
        if head["kind"] == "label_map":
            member = membership(self._groups, head["classes"], CHANNELS)
            self._label_scores = label_log_scores(
                member, head.get("confidence", 0.9), self._classes, padding=float(PADDING_LOG)
            )

    def prepare(self, image: Message[Image]) -> Tensors:
        pixels = eight_bit(image.payload)
        pictures = []
        for x0, _, x1, _ in self._windows(pixels):
            picture = self._grid.fit(pixels[:, x0:x1])
            for table in self._gammas:
                exposed = picture if table is None else np.asarray(cv2.LUT(picture, table))
                pictures.append(in_color_order(exposed, self.model.color))
        # A single picture is passed on as a view: a frame of the right size is never copied.
        batch = pictures[0][None] if len(pictures) == 1 else np.stack(pictures)
        return {self.model.input_name: Tensor(batch)}

    def finish(self, outputs: Tensors, image: Message[Image]) -> ClassScores:
        data = image.payload.data
        if self.model.head["kind"] == "label_map":
            answer = outputs["labels"]
            scores = Tensor(self._read_labels(answer.array))
        else:
            answer = outputs["scores"]
            scores = self._read_logits(answer)
        rows, columns = answer.array.shape[1:3]
        rects = [self._grid.rect(window, (rows, columns)) for window in self._windows(data)]
        return ClassScores(
            grid=scores.array,
            rects=np.array(rects, dtype=np.float32),
            scale=scores.scale,
            zero_point=scores.zero_point,
            camera=image.payload.camera,
            size=(data.shape[1], data.shape[0]),
        )

    def _windows(self, data: NDArray[np.generic]) -> list[tuple[int, int, int, int]]:
        """x0 y0 x1 y1 of every tile, pixel edges."""
        height, width = data.shape[:2]
        windows = []
        for tile in self.tiles or (Tiling(width / height, 1),):
            tile_width = min(width, round(tile.aspect * height))
            for x0 in np.linspace(0, width - tile_width, tile.count).round().astype(int).tolist():
                windows.append((x0, 0, x0 + tile_width, height))
        return windows

    def _read_logits(self, scores: Tensor) -> Tensor:
        """Our log scores (tiles, rows, columns, CHANNELS) of the logits of all pictures."""
        if self._groups:
            logits = self._over_gammas(scores.values())
            member = membership(self._groups, logits.shape[-1], CHANNELS)
            return Tensor(
                grouped_log_scores(
                    logits,
                    member,
                    self._classes,
                    temperature=self.temperature,
                    padding=float(PADDING_LOG),
                )
            )
        if scores.array.shape[-1] != CHANNELS:
            raise ModelError(
                f"model '{self.model.name}' has {scores.array.shape[-1]} channels; "
                f"without a class_map it needs the taxonomy's {CHANNELS}"
            )
        if len(self._gammas) > 1:
            return Tensor(self._over_gammas(scores.values()) / np.float32(self.temperature))
        return Tensor(scores.array, scores.scale / self.temperature, scores.zero_point)

    def _read_labels(self, labels: NDArray[np.generic]) -> NDArray[np.float32]:
        """The same of label maps (n, rows, columns), sampled every `stride` pixels."""
        rows, columns = (self._grid.taken(cells) for cells in labels.shape[1:])
        sampled = labels[:, rows[:, None], columns]
        return self._over_gammas(self._label_scores[sampled])

    def _over_gammas(self, scores: NDArray[np.float32]) -> NDArray[np.float32]:
        """(tiles * gammas, ...) averaged over the exposures of each tile."""
        if len(self._gammas) == 1:
            return scores
        exposures = scores.reshape(-1, len(self._gammas), *scores.shape[1:])
        return np.asarray(exposures.mean(axis=1), dtype=np.float32)
