from __future__ import annotations

import numpy as np
from head_oracle import decoded

from pipeline.model import Tensor


def test_detection_output_is_read_up_to_its_end_mark() -> None:
    rows = np.array(
        [
            [0, 1, 0.9, 0.1, 0.2, 0.3, 0.4],
            [0, 2, 0.5, 0.5, 0.6, 0.7, 0.8],
            [-1, 0, 0, 0, 0, 0, 0],
            [0, 1, 1.0, 0.0, 0.0, 1.0, 1.0],
        ],
        dtype=np.float32,
    )
    head = {"kind": "detection_output", "class_map": {1: "person"}}
    boxes, classes, scores = decoded(head, {"detections": Tensor(rows[None, None])}, 0.5)
    np.testing.assert_allclose(boxes, rows[:2, 3:], rtol=1e-6)
    assert classes.tolist() == [1, 2]
    np.testing.assert_allclose(scores, [0.9, 0.5], rtol=1e-6)
