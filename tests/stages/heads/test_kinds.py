from __future__ import annotations

from typing import Any

import pytest

from accelerators.registry import Registry
from pipeline.errors import ModelError
from pipeline.model import ModelSpec
from stages.heads.kinds import HEADS, read_head


def spec(head: dict[str, Any]) -> ModelSpec:
    return ModelSpec("net", "image", (8, 8, 3), "uint8", "rgb", {"class_map": {}, **head})


ANCHORS = {"kind": "ssd", "maps": [2], "scales": [0.2]}


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ({"kind": "sdd"}, "head of kind 'sdd'; a detector's is one of centernet, .*, yolo"),
        ({"kind": "yolo", "stride": [8]}, "head: unknown key 'stride'; did you mean 'strides'"),
        ({"kind": "ssd"}, "net.*misses 'anchors'"),
        ({"kind": "ssd", "anchors": {"kind": "ssd", "scales": [1]}}, "anchors: misses 'maps'"),
        (
            {"kind": "ssd", "anchors": {"kind": "ssd", "maps": [0], "scales": [1]}},
            "must be at least 1",
        ),
        (
            {"kind": "ssd", "anchors": ANCHORS, "coder": [10, 10, 5]},
            "head.coder",
        ),
        (
            {"kind": "ssd", "anchors": ANCHORS, "scores": "sigmoyd"},
            "did you mean 'sigmoid'",
        ),
        ({"kind": "centernet", "order": "zx"}, "head.order: expected 'xy' or 'yx', got 'zx'"),
    ],
)
def test_a_wrong_head_block_is_refused_with_its_place(head: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        read_head(spec(head))


def test_every_detector_of_the_shipped_registry_has_a_readable_head() -> None:
    models = Registry.open()
    detectors = [name for name in models.names() if name.startswith("detect-")]
    assert len(detectors) >= 9
    for name in detectors:
        head = read_head(models.spec(name))
        assert isinstance(head, HEADS[head.kind])
        head.decoder((64, 64), 0.5)
