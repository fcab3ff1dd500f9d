"""Makes an .onnx file of a model's 8-bit .tflite, so that OpenVINO and ONNX Runtime run it too.

tf2onnx takes the quantization out: the file computes in 32 bits, with the rounded weights, and its
input and outputs stay those of the .tflite. It needs TensorFlow and is an extra of its own.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelerators.litert import TfliteCpu
from accelerators.model_file import Interface, read_interface
from accelerators.onnx import Onnx
from accelerators.registry import Registry
from accelerators.registry_file import OutputEntry, VariantEntry, read_registry
from pipeline.errors import ModelError
from pipeline.model import Tensor, TensorSpec
from tools.models.add import write_entry
from tools.models.entry import from_nearest, sha256_of

#: The first with all that quantized networks are made of, and old enough for every runtime.
OPSET = 13
#: The made-up picture grows darker from above to below, and is grainy: of flat colors a network
#: that was trained in 8 bits makes values that end at its limits in 8 bits and not in 32.
BRIGHTNESS = (220, 60)
GRAIN = 10


@dataclass(frozen=True, slots=True)
class Converted:
    """A file that was made."""

    file: Path
    #: By output of numbers: how far it is from the .tflite's on a made-up picture, as a share of
    #: what that varies by. Rounding to 8 bits makes some percent; near 1, it is something else.
    #: Where an output is sorted, as boxes are, one that changed its place counts whole.
    differences: Mapping[str, float]


def convert_model(name: str, registry: Path, models: Sequence[Path] = ()) -> Converted:
    """Write NAME_f32.onnx beside the registry file, and its variant with the model's entry into it.

    The model may be one that ships, of the further registry files `models`, or of `registry`
    itself. Raises ModelError.
    """
    here = [registry] if registry.exists() else []
    known = Registry.open(*models, *here)
    entry = known.entry(name)
    for variant in entry.variants:
        if variant.kind == "onnx":
            raise ModelError(f"model '{name}' has an .onnx file already, {variant.file}")
    source = next((one for one in entry.variants if one.kind == "tflite"), None)
    if source is None:
        raise ModelError(
            f"model '{name}' has no .tflite file to convert; it has "
            f"{', '.join(one.kind for one in entry.variants)}"
        )
    path, _ = known.files(name, source)
    assert path is not None, "a .tflite variant is a file"
    onnx = registry.parent / f"{name}_f32.onnx"
    onnx.parent.mkdir(parents=True, exist_ok=True)
    tflite_to_onnx(path, [one.name for one in source.outputs.values() if one.name], onnx)
    roots = read_registry(registry).roots if here else (".",)
    added = _variant(source, path, onnx, [registry.parent / root for root in roots])
    kept = entry.model_dump(exclude_defaults=True)
    variants = [*kept["variants"], added]
    write_entry(
        registry, name, kept | {"variants": variants}, replace=True, known=len(entry.variants)
    )
    after = Registry.open(*models, registry)
    return Converted(onnx, _differences(after, name, source, after.entry(name).variants[-1]))


def tflite_to_onnx(tflite: Path, outputs: Sequence[str], onnx: Path) -> None:
    """Run tf2onnx in a process of its own: it brings TensorFlow, and says a lot. Raises ModelError.

    `outputs` are names in the file, and cut it there; none means the file's own.
    """
    if not all(importlib.util.find_spec(package) for package in ("tf2onnx", "tensorflow")):
        raise ModelError(
            "converting needs tf2onnx and TensorFlow (1.6 GB): pip install 'overflight[convert]'; "
            "the file that it makes runs without them"
        )
    half = onnx.with_name(onnx.name + ".new")
    command = [sys.executable, "-m", "tf2onnx.convert", "--dequantize", "--opset", str(OPSET)]
    command += ["--tflite", str(tflite), "--output", str(half)]
    command += ["--outputs", ",".join(outputs)] if outputs else []
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode != 0 or not half.is_file():
        said = [line for line in run.stderr.splitlines() if line.strip()] or ["no word"]
        raise ModelError(f"{tflite}: tf2onnx does not convert it ({said[-1].strip()})")
    half.replace(onnx)


def _variant(
    source: VariantEntry, tflite: Path, onnx: Path, folders: Sequence[Path]
) -> dict[str, Any]:
    """The entry of the new file: as the .tflite's, but for what the file says itself."""
    cuts = [one.tensor for one in source.outputs.values() if one.tensor is not None]
    was, now = read_interface(tflite, cuts), read_interface(onnx)
    kept = {"layout", "color", "constants"}
    return {
        "kind": "onnx",
        "file": from_nearest(onnx, folders),
        "sha256": sha256_of(onnx),
        **source.model_dump(exclude_defaults=True, include=kept),
        **normalization(source, was, now),
        "outputs": {
            ours: _output(entry, was.outputs, now.outputs) for ours, entry in source.outputs.items()
        },
    }


def _output(
    entry: OutputEntry, was: Mapping[str, TensorSpec], now: Mapping[str, TensorSpec]
) -> dict[str, Any]:
    """An output found by its name, with its quantization, which an .onnx does not state."""
    name = entry.name or next(iter(now))
    if name not in now:
        raise ModelError(f"tf2onnx gave the output '{name}' another name, one of {', '.join(now)}")
    said = entry.model_dump(exclude_defaults=True, exclude={"tensor", "name", "dtype"})
    spec = was.get(name)
    if spec is not None and spec.scale and spec.dtype == now[name].dtype:
        said |= {"scale": float(f"{spec.scale:.8g}"), "zero_point": spec.zero_point}
    return {"name": name, "dtype": now[name].dtype} | said


def normalization(source: VariantEntry, tflite: Interface, onnx: Interface) -> dict[str, Any]:
    """mean and std of the new file. An 8-bit input is stored as before, but an .onnx does not say
    how: real = (stored - zero point) * scale goes into the entry.
    """
    name = next(key for key in tflite.inputs if key not in source.constants)
    was, now = tflite.inputs[name], onnx.inputs.get(name)
    scale, zero_point = (was.scale, was.zero_point) if now and was.dtype == now.dtype else (0.0, 0)
    pairs = [
        (mean - zero_point * std * scale, std * scale) if scale else (mean, std)
        for mean, std in zip(*np.broadcast_arrays(source.mean, source.std), strict=True)
    ]
    means, stds = ([round(float(one), 6) for one in column] for column in zip(*pairs, strict=True))
    return {"mean": means, "std": stds}


def _differences(
    models: Registry, name: str, tflite: VariantEntry, onnx: VariantEntry
) -> Mapping[str, float]:
    """How far the two files' outputs are apart, by output; see `Converted`."""
    spec = models.spec(name)
    height, width, channels = spec.input_shape
    grain = np.random.default_rng(0).normal(0, GRAIN, (1, height, width, channels))
    picture = (np.linspace(*BRIGHTNESS, height)[:, None, None] + grain).clip(0, 255)
    given = {spec.input_name: Tensor(picture.astype(spec.input_dtype))}
    a, b = (
        model.decode(model.infer(model.encode(given)))
        for model in (models.load(name, TfliteCpu(), tflite), models.load(name, Onnx(), onnx))
    )
    return {
        output: float(np.abs(a[output].values() - b[output].values()).mean())
        / max(float(a[output].values().std()), 1e-9)
        for output in a
        if a[output].scale != 1.0 or a[output].array.dtype.kind == "f"  # labels are no quantities
    }
