"""Stages that say what is true in place of a network: what is then wrong is fusion or geometry."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.stage import Stage
from stages.labels import Labels
from stages.taxonomy import load_taxonomy
from stages.types import CHANNELS, PADDING_LOG, ClassScores, Cloud, Scan

#: As sure as a source of evidence may be (`stages.kernels.probability.LEAST`).
SURE = 1.0 - 1e-6


class TrueScores(Stage):
    """The scores of a segmentation that is right at every pixel, at full resolution."""

    stateless = True

    def __init__(self, *, confidence: float = SURE) -> None:
        """`confidence`: the probability claimed of the true class; the others share the rest."""
        self._log_odds = log_odds(confidence)

    def process(self, labels: Message[Labels]) -> ClassScores:
        classes = labels.payload.classes
        height, width = classes.shape
        one_hot = np.arange(CHANNELS, dtype=np.uint8) == classes[..., None]
        return ClassScores(
            grid=one_hot[None].view(np.int8),
            rects=np.array([[0, 0, width, height]], dtype=np.float32),
            scale=self._log_odds,
            zero_point=0,
            camera=labels.payload.sensor,
            size=(width, height),
        )


class TrueCloud(Stage):
    """The scan of a segmentation that is right at every return, or of one that errs by chance.

    `mistakes` makes it a poor but honest network, to see what fusion adds: with the confidence that
    fits its mistakes, that of evidence as Bayes wants it. A ray without a return gets none.
    """

    def __init__(self, *, confidence: float = SURE, mistakes: float = 0.0, seed: int = 0) -> None:
        """`confidence` as in `TrueScores`; `mistakes`: the share of the returns of which it says
        another class, drawn evenly with `seed` and the scan's number."""
        if not 0 <= mistakes < 1:
            raise ValueError(f"mistakes must be at least 0 and below 1, not {mistakes}")
        self._log_odds = log_odds(confidence)
        self._mistakes = mistakes
        self._seed = seed
        self._classes = len(load_taxonomy())

    def process(self, scan: Message[Scan], labels: Message[Labels]) -> Cloud:
        payload = scan.payload
        said = labels.payload.classes.ravel()
        if len(said) != len(payload.points):
            raise StageError(
                f"{len(said)} labels of '{labels.payload.sensor}' for the {len(payload.points)} "
                f"points of '{payload.sensor}'; give the labels of that scan (sync: exact)"
            )
        evidence = said > 0
        if self._mistakes:
            said = self._err(said, scan.seq)
        rows = np.zeros((len(said), CHANNELS), dtype=np.float32)
        rows[np.arange(len(said)), said] = self._log_odds
        rows[:, self._classes :] = PADDING_LOG
        times, shape = payload.times_ns, payload.shape
        return Cloud(payload.points, rows, evidence, None, payload.sensor, times, shape)

    def _err(self, said: NDArray[np.uint8], scan: int) -> NDArray[np.uint8]:
        """The classes (n,), a share of them exchanged for another one, never for background."""
        random = np.random.default_rng([self._seed, scan])
        real = self._classes - 1
        step = random.integers(1, real, len(said))
        other = (said.astype(np.int64) - 1 + step) % real + 1
        wrong = random.random(len(said)) < self._mistakes
        return np.where(wrong & (said > 0), other, said).astype(np.uint8)


def log_odds(confidence: float) -> float:
    """The log score, above that of each other class, of a class of this probability.

    Raises ValueError where it is not above even odds or certain.
    """
    classes = len(load_taxonomy())
    if not 1 / classes < confidence < 1:
        raise ValueError(
            f"confidence must lie above 1 / {classes} classes and below 1, not {confidence}"
        )
    return math.log(confidence * (classes - 1) / (1 - confidence))
