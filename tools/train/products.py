"""What a training leaves behind: model files, their registry entry, a model card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import ModelError
from tools.models.add import add_model
from tools.models.entry import Said
from tools.train.export import (
    Exportable,
    rounding,
    write_onnx,
    write_openvino,
    write_tflite,
)

REGISTRY = "models.yaml"
#: So many inputs tell the 8-bit file which values each tensor takes: each further one may widen a
#: range, and with it every step. Of 200 scans segment-scan lost 5 points in 8 bits.
SAMPLES = 48


@dataclass(frozen=True, slots=True)
class Meaning:
    """What the registry says of the files, and they do not say themselves."""

    description: str
    license: str
    source: str
    head: Mapping[str, Any]
    classes: Mapping[int, str]
    color: str | None
    mean: float
    std: float


def write_products(
    model: Exportable,
    meaning: Meaning,
    samples: Sequence[NDArray[np.float32]],
    folder: Path,
    console: Console,
) -> list[Path]:
    """Write the files, enter them in `folder`/models.yaml; the 8-bit one, which is left out where
    there are no samples, needs the extra `export`.

    Raises ModelError where a file does not do what its network does.
    """
    onnx = write_onnx(model, folder)
    files = [write_openvino(model, onnx, folder), onnx]
    if samples:
        files = [*_eight_bit(model, samples, folder, console), *files]
    said = Said(
        head=meaning.head,
        classes=meaning.classes,
        outputs={name: name for name in model.outputs},
        color=meaning.color,
        mean=[meaning.mean],
        std=[meaning.std],
        description=meaning.description,
        license=meaning.license,
        source=meaning.source,
    )
    add_model(model.name, files, said, folder / REGISTRY, replace=True)
    return files


def _eight_bit(
    model: Exportable, samples: Sequence[NDArray[np.float32]], folder: Path, console: Console
) -> list[Path]:
    """The 8-bit file, or a word on why there is none."""
    try:
        whole = write_tflite(model, samples, folder)
    except ModelError as error:
        if "extra 'export'" not in str(error):
            raise
        console.print(f"No 8-bit file: {error}", style="yellow", highlight=False, soft_wrap=True)
        return []
    shares = rounding(whole, model, samples[0])
    told = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items())
    console.print(f"8-bit rounding, of what the output varies by: {told}", highlight=False)
    return [whole]
