"""How well boxes are found: average precision, and how sure one can be of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class FrameHits:
    """The detections of one class in one frame, best first."""

    scores: NDArray[np.float32]  #: (n,) falling
    hits: NDArray[np.bool_]  #: (n,) which found an object that no better one had found
    objects: int  #: how many there were to find


def overlaps(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, m) shared area of boxes x0 y0 x1 y1 (n, 4) and (m, 4)."""
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    return np.asarray(np.clip(high - low, 0, None).prod(axis=2), dtype=np.float32)


def areas(boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) areas of boxes x0 y0 x1 y1 (n, 4)."""
    return np.asarray((boxes[:, 2:] - boxes[:, :2]).prod(axis=1), dtype=np.float32)


def match(
    boxes: NDArray[np.float32],
    scores: NDArray[np.float32],
    objects: NDArray[np.float32],
    ignored: NDArray[np.float32],
    min_iou: float = 0.5,
) -> FrameHits:
    """Give each detection, best first, the free object that it overlaps most, from `min_iou` on.

    All boxes are of one class and frame, x0 y0 x1 y1. A detection that finds no object and lies by
    half or more of its area in an `ignored` region counts neither way.
    """
    order = np.argsort(-scores, kind="stable")
    boxes, scores = boxes[order], scores[order]
    hits = assigned(boxes, objects, min_iou) >= 0
    inside = overlaps(boxes, ignored).max(axis=1, initial=0) >= 0.5 * areas(boxes)
    counted = hits | ~inside
    return FrameHits(scores[counted], hits[counted], len(objects))


def assigned(
    boxes: NDArray[np.float32], objects: NDArray[np.float32], min_iou: float = 0.5
) -> NDArray[np.int64]:
    """(n,) which object each of the boxes (n, 4) finds, in their order: the free one that it
    overlaps most, from `min_iou` on; -1 where it finds none."""
    shared = overlaps(boxes, objects)
    union = areas(boxes)[:, None] + areas(objects)[None, :] - shared
    iou = shared / np.maximum(union, 1e-9)
    found = np.full(len(boxes), -1, dtype=np.int64)
    for number in range(len(boxes) if len(objects) else 0):
        best = int(np.argmax(iou[number]))
        if iou[number, best] >= min_iou:
            found[number] = best
            iou[:, best] = -1
    return found


def average_precision(frames: Sequence[FrameHits]) -> float:
    """The area under the precision-recall curve of all frames together, 0..1; NaN without objects.

    All points, precision made monotonous from the right (as PASCAL VOC since 2010).
    """
    objects = sum(frame.objects for frame in frames)
    if not objects:
        return float("nan")
    scores = np.concatenate([frame.scores for frame in frames])
    hits = np.concatenate([frame.hits for frame in frames])[np.argsort(-scores, kind="stable")]
    found = np.cumsum(hits)
    precision = found / np.arange(1, len(hits) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(envelope[hits].sum() / objects)


def bootstrap_interval(
    frames: Sequence[FrameHits], *, coverage: float = 0.9, rounds: int = 1000, seed: int = 0
) -> tuple[float, float]:
    """Between which values the average precision lies in `coverage` of the draws of as many frames.

    Frames are drawn with replacement, since the objects of one frame are no independent trials.
    Draws without an object are left out; NaN where there is no other.
    """
    random = np.random.default_rng(seed)
    draws = [
        average_precision([frames[k] for k in random.integers(len(frames), size=len(frames))])
        for _ in range(rounds)
    ]
    known = [value for value in draws if not np.isnan(value)]
    if not known:
        return float("nan"), float("nan")
    low, high = np.quantile(known, [(1 - coverage) / 2, (1 + coverage) / 2])
    return float(low), float(high)


def recall_at(frames: Sequence[FrameHits], score: float) -> tuple[float, float]:
    """Recall and precision of the detections scored at least `score`; NaN without any."""
    objects = sum(frame.objects for frame in frames)
    kept = [frame.scores >= score for frame in frames]
    given = sum(int(mask.sum()) for mask in kept)
    found = sum(int(frame.hits[mask].sum()) for frame, mask in zip(frames, kept, strict=True))
    return found / objects if objects else float("nan"), found / given if given else float("nan")
