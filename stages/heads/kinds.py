"""Which heads there are, and the one that a model's registry entry asks for."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import ValidationError

from pipeline.errors import ModelError
from pipeline.graph.wording import explain, suggest
from pipeline.model import ModelSpec
from stages.heads.centernet import CenterNet
from stages.heads.detection_output import DetectionOutput
from stages.heads.fastestdet import FastestDet
from stages.heads.head import Head
from stages.heads.ssd import Ssd
from stages.heads.ssd_postprocessed import SsdPostprocessed
from stages.heads.yolo import Yolo

HEADS: Mapping[str, type[Head]] = {
    "centernet": CenterNet,
    "detection_output": DetectionOutput,
    "fastestdet": FastestDet,
    "ssd": Ssd,
    "ssd_postprocessed": SsdPostprocessed,
    "yolo": Yolo,
}


def read_head(model: ModelSpec) -> Head:
    """The head of a detector with its settings. Raises ModelError naming the key."""
    block = dict(model.head)
    if block["kind"] not in HEADS:
        raise ModelError(
            f"model '{model.name}' has a head of kind '{block['kind']}'; "
            f"a detector's is one of {', '.join(HEADS)}"
        )
    head = HEADS[block["kind"]]
    for key in block:
        if key not in head.model_fields:
            way_out = suggest(key, head.model_fields)
            raise ModelError(f"model '{model.name}': head: unknown key '{key}'{way_out}")
    try:
        return head.model_validate(block)
    except ValidationError as error:
        mistakes = [
            ".".join(map(str, ("head", *steps))) + f": {sentence}"
            for steps, sentence in explain(error.errors(), block)
        ]
        raise ModelError(f"model '{model.name}': {'; '.join(mistakes)}") from None
