"""A model file held against its registry entry: does it fit, and how is it to be read?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from accelerators.model_file import KINDS, read_interface
from accelerators.registry_file import OutputEntry, VariantEntry
from accelerators.tensors import InputForm, OutputForm, file_input
from pipeline.errors import ModelError
from pipeline.model import ModelSpec, TensorSpec

#: What to say of a file of this kind under an entry of another.
_OTHER_KIND = {
    "edgetpu": (
        "is compiled for the Edge TPU and runs nowhere else; make its kind 'edgetpu', and name the "
        ".tflite that it was compiled from for the other devices"
    ),
    "tflite": (
        "is TensorFlow Lite and not compiled for the Edge TPU; make its kind 'tflite', or compile "
        "it with edgetpu_compiler"
    ),
    "onnx": "is an ONNX model; make its kind 'onnx'",
    "openvino": "is an OpenVINO model; make its kind 'openvino'",
}


def check_file(spec: ModelSpec, variant: VariantEntry, path: Path) -> None:
    """Hold a file against its entry without a runtime: kind, input, outputs.

    Raises ModelError with the way out. Kinds that `model_file` does not read are not looked into.
    """
    if variant.kind not in KINDS:
        return
    interface = read_interface(path)
    if interface.kind != variant.kind:
        raise ModelError(f"model '{spec.name}': {path} {_OTHER_KIND[interface.kind]}")
    if cuts := [one.tensor for one in variant.outputs.values() if one.tensor is not None]:
        interface = read_interface(path, cuts)
    free = {key: one for key, one in interface.inputs.items() if key not in variant.constants}
    file_input(spec, input_form(spec, variant), free)
    output_forms(spec.name, variant, interface.outputs)


def input_form(spec: ModelSpec, variant: VariantEntry) -> InputForm:
    """What the entry says of the file's input."""
    return InputForm(
        mean=variant.mean,
        std=variant.std,
        nchw=variant.layout == "nchw",
        reverse_channels=variant.color not in (None, spec.color),
    )


def output_forms(
    name: str, variant: VariantEntry, found: Mapping[str, TensorSpec]
) -> Mapping[str, OutputForm]:
    """The file's outputs by canonical name, held against the entry; raises ModelError."""
    forms = {}
    known = ", ".join(found)
    for canonical, entry in variant.outputs.items():
        native = entry.name
        if native is None and len(found) == 1:
            native = next(iter(found))
        if native is None or native not in found:
            raise ModelError(
                f"model '{name}': output '{canonical}' is named {native!r} in the registry; "
                f"the file has {known}"
            )
        _compare(name, canonical, entry, found[native])
        if entry.layout == "nchw" and len(found[native].shape) not in (0, 4):
            raise ModelError(
                f"model '{name}': output '{canonical}' has shape {found[native].shape}; only four "
                "dimensions can have 'layout: nchw'"
            )
        forms[canonical] = OutputForm(
            native, entry.layout == "nchw", entry.scale or 1.0, entry.zero_point or 0
        )
    return forms


def _compare(model: str, output: str, entry: OutputEntry, stated: TensorSpec) -> None:
    """Raise ModelError where an entry says otherwise than the file; both may leave things open."""
    for key in ("shape", "dtype", "scale", "zero_point"):
        said, found = getattr(entry, key), getattr(stated, key)
        # .onnx and OpenVINO files do not state the quantization of their 8-bit outputs.
        silent = key in ("scale", "zero_point") and not stated.scale and "int" in stated.dtype
        if said is None or silent:
            continue
        if key == "shape":
            same = not found or len(said) == len(found)  # none at all: known when it runs
            same = same and all(f in (-1, s) for s, f in zip(said, found, strict=False))
        else:
            same = abs(said - found) < 1e-4 * found if key == "scale" else said == found
        if not same:
            raise ModelError(
                f"model '{model}': output '{output}' has {key} {found} in the file, "
                f"{said} in the registry; correct the entry, or name the file that it describes"
            )
