"""What the tests of all heads share: stored outputs, and the comparison with a slow oracle."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.model import ModelSpec, Tensor, Tensors
from stages.heads.kinds import read_head
from stages.kernels.boxes import Found

#: x0, y0, x1, y1 in parts, class, score.
Row: TypeAlias = tuple[float, float, float, float, int, float]


def decoded(
    head: dict[str, Any], outputs: Tensors, min_score: float, picture: tuple[int, int] = (64, 48)
) -> Found:
    width, height = picture
    spec = ModelSpec("net", "image", (height, width, 3), "uint8", "rgb", head)
    return read_head(spec).decoder(picture, min_score)(outputs)


def stored(values: NDArray[Any], dtype: str) -> Tensor:
    """The values (1, ...) as a file would hold them."""
    if dtype == "float32":
        return Tensor(values.astype(np.float32))
    limits = np.iinfo(dtype)
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 1e-3)
    scale = (high - low) / 255
    zero_point = round(limits.min - low / scale)
    array = np.clip(np.rint(values / scale) + zero_point, limits.min, limits.max).astype(dtype)
    return Tensor(array, scale, zero_point)


def real(tensor: Tensor) -> NDArray[np.float64]:
    """What the stored numbers stand for, of the one picture."""
    return np.asarray((tensor.array[0].astype(np.float64) - tensor.zero_point) * tensor.scale)


def assert_found(found: Found, expected: list[Row], min_score: float) -> None:
    """Those found at or above the score are the expected ones that are, in the same order."""
    if any(abs(row[5] - min_score) < 1e-5 for row in expected):
        return  # rounding decides
    boxes, classes, scores = found
    strong = scores >= min_score
    wanted = [row for row in expected if row[5] >= min_score]
    assert classes[strong].tolist() == [row[4] for row in wanted]
    np.testing.assert_allclose(scores[strong], [row[5] for row in wanted], atol=1e-5)
    corners = np.array([row[:4] for row in wanted]).reshape(-1, 4)
    np.testing.assert_allclose(boxes[strong], corners, rtol=1e-4, atol=1e-5)


def sigmoid(x: Any) -> Any:
    return 1 / (1 + np.exp(-x))
