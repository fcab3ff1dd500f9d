"""A registry entry from the model files themselves, and what a person has to say beside them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from accelerators.model_file import Interface, find_tensor, read_interface
from pipeline.errors import ModelError
from pipeline.graph.wording import suggest
from pipeline.model import TensorSpec
from stages.taxonomy import load_taxonomy

#: The outputs that a stage expects of each kind of head, in its words.
HEAD_OUTPUTS: Mapping[str, tuple[str, ...]] = {
    "scores": ("scores",),
    "label_map": ("labels",),
    "detection_output": ("detections",),
    "fastestdet": ("grid",),
    "ssd": ("boxes", "scores"),
    "ssd_postprocessed": ("boxes", "classes", "scores", "count"),
    "yolo": ("rows",),
    "centernet": ("heat", "size", "offset"),
}
#: Heads whose outputs are maps over the picture, laid out as the input is.
_MAPS = ("scores", "fastestdet", "centernet")


@dataclass(frozen=True, slots=True)
class Said:
    """What no model file says. None or empty: not said either, so it is assumed."""

    head: Mapping[str, Any]  #: kind and settings
    classes: Mapping[int, str]
    outputs: Mapping[str, str]  #: canonical name: name in the file
    color: str | None
    mean: Sequence[float]
    std: Sequence[float]
    description: str
    license: str
    source: str


@dataclass(frozen=True, slots=True)
class Written:
    """An entry, ready for the registry file."""

    entry: Mapping[str, Any]
    assumed: Sequence[str]  #: what neither the files nor the person said, one sentence each


def guess_head(file: Path) -> str | None:
    """The kind of head that the outputs of a file look like; None where several would do."""
    outputs = [spec.shape for spec in read_interface(file).outputs.values()]
    if len(outputs) == 1 and len(outputs[0]) == 4 and outputs[0][-1] == 7:
        return "detection_output"
    if len(outputs) == 1 and len(outputs[0]) == 3 and min(outputs[0][1:]) > 200:
        return "label_map"
    if [shape[-1:] for shape in outputs[:1]] == [(4,)] and len(outputs) in (2, 4):
        return "ssd" if len(outputs) == 2 else "ssd_postprocessed"
    return None


def parse_head(text: str) -> Mapping[str, Any]:
    """``scores`` or ``{kind: label_map, stride: 4}``. Raises ModelError."""
    head = yaml.safe_load(text)
    if isinstance(head, str):
        head = {"kind": head}
    kind = head.get("kind") if isinstance(head, dict) else None
    if kind not in HEAD_OUTPUTS:
        raise ModelError(f"no kind of head '{kind}'{suggest(str(kind), HEAD_OUTPUTS)}")
    return dict(head)


def parse_classes(text: str) -> Mapping[int, str]:
    """``0=road,1=sidewalk``, or a label set of the taxonomy, as cityscapes. Raises ModelError."""
    taxonomy = load_taxonomy()
    if "=" not in text:
        if text not in taxonomy.maps:
            raise ModelError(f"no label set '{text}'{suggest(text, taxonomy.maps)}")
        pairs = {theirs: ours for ours, ids in taxonomy.maps[text].items() for theirs in ids}
        return dict(sorted(pairs.items()))
    classes: dict[int, str] = {}
    for pair in text.split(","):
        number, _, name = (part.strip() for part in pair.partition("="))
        if not number.isdecimal():
            raise ModelError(f"'{pair}': classes look like 0=road,1=sidewalk")
        if name not in taxonomy.names:
            raise ModelError(f"no class '{name}'{suggest(name, taxonomy.names)}")
        classes[int(number)] = name
    return classes


def entry_of(files: Sequence[Path], said: Said, folders: Sequence[Path]) -> Written:
    """The entry of a model whose variants are `files`; paths in it are seen from one of `folders`.

    Raises ModelError where a file cannot be read or the files are not of one model.
    """
    assumed: list[str] = []
    image: dict[str, Any] = {}
    variants = []
    for file in files:
        interface = read_interface(file)
        name, spec = _image_input(file, interface)
        nchw = _is_nchw(spec.shape)
        canonical = _canonical_input(name, spec, nchw, said.color)
        if image and image["shape"] != canonical["shape"]:
            raise ModelError(
                f"{file}: takes {canonical['shape']}, {files[0]} takes {image['shape']}; files of "
                "one model take one size"
            )
        image = image or canonical
        variants.append(_variant(file, folders, interface, spec, nchw, said, assumed))
    _share_quantization(variants, assumed)
    if said.color is None and image.get("color"):
        assumed.insert(0, f"the order of the channels is {image['color']} (--color)")
    for key in ("license", "source"):
        if not getattr(said, key):
            assumed.append(f"the {key} is not stated (--{key})")
    if not said.classes:
        assumed.append("the class map is empty: channels are the taxonomy's own (--classes)")
    head = dict(said.head) | ({"class_map": dict(said.classes)} if said.classes else {})
    entry = {
        "description": said.description or f"{files[0].stem}, added from its file",
        "license": said.license or "not stated",
        "source": said.source or "not stated",
        "input": image,
        "head": head,
        "variants": variants,
    }
    return Written(entry, tuple(dict.fromkeys(assumed)))


def _image_input(file: Path, interface: Interface) -> tuple[str, TensorSpec]:
    if len(interface.inputs) != 1:
        names = ", ".join(interface.inputs)
        raise ModelError(
            f"{file}: has the inputs {names}; all but the image have to be held at a value with "
            "'constants', which only you know: write this entry by hand"
        )
    name, spec = next(iter(interface.inputs.items()))
    if len(spec.shape) != 4 or min(spec.shape[1:]) < 1:
        shape = ", ".join(map(str, spec.shape))
        raise ModelError(
            f"{file}: takes ({shape}), not images of one size (n, height, width, channels); "
            "give the file fixed sizes"
        )
    return name, spec


def _is_nchw(shape: tuple[int, ...]) -> bool:
    """Whether the channels come first: a picture has 1 or 3, and other inputs have few."""
    for channels, first in ((shape[3], False), (shape[1], True)):
        if channels in (1, 3):
            return first
    return shape[1] < shape[3]


def _canonical_input(name: str, spec: TensorSpec, nchw: bool, color: str | None) -> dict[str, Any]:
    first, second, third = spec.shape[1:]
    height, width, channels = (second, third, first) if nchw else (first, second, third)
    is_image = channels in (1, 3)
    image: dict[str, Any] = {} if is_image else {"name": "range_image"}
    image |= {"shape": [height, width, channels], "dtype": "uint8" if is_image else "float32"}
    if is_image:
        image["color"] = color or ("rgb" if channels == 3 else "gray")
    return image


def _variant(
    file: Path,
    folders: Sequence[Path],
    interface: Interface,
    spec: TensorSpec,
    nchw: bool,
    said: Said,
    assumed: list[str],
) -> dict[str, Any]:
    variant: dict[str, Any] = {"kind": interface.kind}
    variant |= {"file": from_nearest(file, folders), "sha256": sha256_of(file)}
    if interface.kind == "openvino":
        weights = file.with_suffix(".bin")
        if not weights.is_file():
            raise ModelError(f"{weights}: no such file; it holds the weights of {file.name}")
        variant |= {"weights": from_nearest(weights, folders), "weights_sha256": sha256_of(weights)}
    if nchw:
        variant["layout"] = "nchw"
    mean, std = list(said.mean), list(said.std)
    if not mean and not std:
        mean, std, how = _normalization(spec)
        assumed.append(f"{file.name} takes {how} (--mean, --std)")
    if any(mean):
        variant["mean"] = mean
    if std and std != [1.0]:
        variant["std"] = std
    maps = nchw and said.head["kind"] in _MAPS
    variant["outputs"] = {
        ours: _output(file, interface, theirs, nchw=maps)
        for ours, theirs in _outputs(file, interface, said, assumed).items()
    }
    return variant


def _normalization(spec: TensorSpec) -> tuple[list[float], list[float], str]:
    """mean and std, and in words what then goes into the file.

    A quantized input takes the 256 values of a picture as its own 256: real = (stored - zero point)
    * scale, so mean is the value that stands for 0 and std the values per 1.
    """
    if not spec.scale:
        return [], [], "a picture's values as they are, 0 to 255"
    lowest = int(np.iinfo(spec.dtype).min)
    mean, std = float(spec.zero_point - lowest), round(1.0 / spec.scale, 3)
    return [mean], [std], f"a picture's bytes as they are (mean {mean:g}, std {std:g})"


def _outputs(file: Path, interface: Interface, said: Said, assumed: list[str]) -> Mapping[str, str]:
    """The name in the file of each output of the head."""
    wanted = HEAD_OUTPUTS[said.head["kind"]]
    named = {ours: theirs for ours, theirs in said.outputs.items() if _has(file, interface, theirs)}
    if len(named) == len(wanted):
        return named
    found = list(interface.outputs)
    if len(found) < len(wanted):
        raise ModelError(
            f"{file}: has {', '.join(found)}; a head of kind '{said.head['kind']}' needs "
            f"{', '.join(wanted)}"
        )
    chosen = dict(zip(wanted, found, strict=False)) | named
    if len(found) > 1:
        pairs = ", ".join(f"{ours}={theirs}" for ours, theirs in chosen.items())
        assumed.append(f"the outputs of {file.name} are {pairs} (--output)")
    return chosen


def _has(file: Path, interface: Interface, name: str) -> bool:
    return name in interface.outputs or find_tensor(file, name) is not None


def _output(file: Path, interface: Interface, name: str, *, nchw: bool) -> dict[str, Any]:
    """One output's block; a tensor inside a .tflite file cuts it there."""
    output: dict[str, Any] = {"name": name}
    spec = interface.outputs.get(name)
    if spec is None and (inside := find_tensor(file, name)) is not None:
        number, spec = inside
        output = {"tensor": number, "name": name}
    assert spec is not None, "an output that the file has, as _outputs made sure"
    if nchw and len(spec.shape) == 4:
        output["layout"] = "nchw"
    if spec.shape and min(spec.shape) > 0:
        output["shape"] = list(spec.shape)
    output["dtype"] = spec.dtype
    if spec.scale:
        output |= {"scale": float(f"{spec.scale:.8g}"), "zero_point": spec.zero_point}
    return output


def _share_quantization(variants: Sequence[dict[str, Any]], assumed: list[str]) -> None:
    """.onnx and OpenVINO files do not state how their 8-bit outputs are quantized; a .tflite of the
    same model does."""
    for variant in variants:
        for ours, output in variant["outputs"].items():
            if "scale" in output or not output["dtype"].endswith("int8"):
                continue
            others = [one["outputs"][ours] for one in variants if "scale" in one["outputs"][ours]]
            file = Path(variant["file"]).name
            if others and others[0]["dtype"] == output["dtype"]:
                output |= {key: others[0][key] for key in ("scale", "zero_point")}
                assumed.append(f"'{ours}' of {file} is quantized as in the other file")
            else:
                assumed.append(f"'{ours}' of {file} is not quantized, though it is 8-bit")


def from_nearest(file: Path, folders: Sequence[Path]) -> str:
    """The file as seen from the folder with the shortest way to it."""
    ways = (os.path.relpath(file.resolve(), folder.resolve()) for folder in folders)
    return min(ways, key=lambda way: (way.count("../"), len(way)))


def sha256_of(file: Path) -> str:
    """The sum of a file, as the registry has it."""
    return hashlib.sha256(file.read_bytes()).hexdigest()
