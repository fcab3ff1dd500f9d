"""The models a graph may name: read from models.yaml, verified, loaded and bound to a device.

A registry file holds `models:` by name and `roots:`, folders (relative to the file) in which the
files of its variants are looked for. Several registry files add up: a later one may replace a model
of the same name, and its roots are searched too, so a registry of nothing but `roots:` says where
downloaded files lie.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from accelerators.tensors import BoundFile, InputForm, OutputForm
from pipeline.errors import ModelError
from pipeline.model import Accelerator, BoundModel, Model, ModelSpec

SHIPPED = Path(__file__).resolve().parents[1] / "graphs" / "models" / "models.yaml"

Color = Literal["rgb", "bgr", "gray", ""]
Layout = Literal["nhwc", "nchw"]


class Entry(BaseModel):
    """A block of a registry file: unknown keys are mistakes, values stay as read."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class InputEntry(Entry):
    """The canonical input that stages prepare."""

    name: str = "image"
    shape: tuple[int, int, int] = Field(description="height, width, channels")
    dtype: Literal["uint8", "int8", "uint16", "float32"] = "uint8"
    color: Color = ""


class HeadEntry(Entry):
    """What the outputs mean; further keys are settings that the stage of that kind understands."""

    model_config = ConfigDict(frozen=True, extra="allow")

    kind: str
    class_map: dict[int, str] = Field(default={}, description="the model's class: our class name")


class OutputEntry(Entry):
    """A canonical output: by `name` in the file (not needed where it has one output)."""

    name: str | None = None
    tensor: int | None = Field(default=None, description="cut the file here; its name beside it")
    layout: Layout = "nhwc"
    shape: tuple[int, ...] | None = Field(default=None, description="with batch; emulated: needed")
    dtype: str | None = None
    scale: float | None = None
    zero_point: int | None = None


class VariantEntry(Entry):
    """One file of a model, for devices of one kind."""

    kind: str
    file: str | None = None
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    weights: str | None = Field(default=None, description="the .bin beside an OpenVINO .xml")
    weights_sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    layout: Layout = "nhwc"
    color: Color | None = Field(default=None, description="channel order of the file, if another")
    mean: tuple[float, ...] = Field(default=(0.0,), description="in the file's channel order")
    std: tuple[float, ...] = (1.0,)
    outputs: dict[str, OutputEntry] = {}


class ModelEntry(Entry):
    """A model: what a stage sees of it, where it comes from, and its files."""

    description: str
    license: str
    source: str
    input: InputEntry
    head: HeadEntry
    variants: tuple[VariantEntry, ...] = Field(min_length=1)


class RegistryFile(Entry):
    """A registry file."""

    roots: tuple[str, ...] = (".",)
    models: dict[str, ModelEntry] = {}


class Registry:
    """The models of one or more registry files; a `pipeline.graph.catalog.Catalog`."""

    def __init__(self, models: Mapping[str, ModelEntry], roots: Sequence[Path]) -> None:
        self._models = models
        self._roots = roots
        self._hashes: dict[tuple[Path, int], str] = {}

    @classmethod
    def open(cls, *extra: Path) -> Registry:
        """The shipped registry and a user's further files. Raises ModelError."""
        models: dict[str, ModelEntry] = {}
        roots: list[Path] = []
        for path in (SHIPPED, *extra):
            file = _read(path)
            models.update(file.models)
            roots.extend(path.parent / root for root in file.roots)
        return cls(models, roots)

    def names(self) -> Sequence[str]:
        return list(self._models)

    def entry(self, name: str) -> ModelEntry:
        """The whole entry, for people and tools. Raises ModelError."""
        if name not in self._models:
            close = difflib.get_close_matches(name, self._models, 1)
            way_out = (
                f"did you mean '{close[0]}'?" if close else f"known: {', '.join(self._models)}"
            )
            raise ModelError(f"no model '{name}'; {way_out}")
        return self._models[name]

    def spec(self, name: str) -> ModelSpec:
        entry = self.entry(name)
        return ModelSpec(
            name=name,
            input_name=entry.input.name,
            input_shape=entry.input.shape,
            input_dtype=entry.input.dtype,
            color=entry.input.color,
            head=entry.head.model_dump(),
        )

    def check(self, name: str, device: Accelerator) -> str | None:
        try:
            self._files(name, self._variant(name, device))
        except ModelError as error:
            return str(error)
        return None

    def load(self, name: str, device: Accelerator) -> BoundModel:
        variant = self._variant(name, device)
        path, weights = self._files(name, variant)
        spec = self.spec(name)
        settings: dict[str, Any] = variant.model_dump(exclude_none=True)
        settings |= {"model": name, "input": self.entry(name).input.model_dump()}
        if weights:
            settings["weights"] = str(weights)
        model = device.load(str(path or ""), settings)
        form = InputForm(
            mean=variant.mean,
            std=variant.std,
            nchw=variant.layout == "nchw",
            reverse_channels=variant.color not in (None, spec.color),
        )
        bound = BoundFile(spec, model, form, _outputs(name, variant, model))
        bound.warm_up()
        return bound

    def _variant(self, name: str, device: Accelerator) -> VariantEntry:
        """The first variant of the kind that the device likes best."""
        variants = self.entry(name).variants
        for kind in device.kinds:
            for variant in variants:
                if variant.kind == kind:
                    return variant
        raise ModelError(
            f"model '{name}' has no variant for {type(device).__name__}, which runs "
            f"{' or '.join(device.kinds)}; it has {', '.join(v.kind for v in variants)}"
        )

    def _files(self, name: str, variant: VariantEntry) -> tuple[Path | None, Path | None]:
        """The verified model file and weights file of a variant."""
        return (
            self._verified(name, variant.file, variant.sha256),
            self._verified(name, variant.weights, variant.weights_sha256),
        )

    def _verified(self, name: str, file: str | None, sha256: str | None) -> Path | None:
        if file is None:
            return None
        for root in self._roots:
            path = (root / file).resolve()
            if path.is_file():
                break
        else:
            places = ", ".join(str(root.resolve()) for root in self._roots)
            raise ModelError(
                f"model '{name}': no file {file} in {places}; put it there (source: "
                f"{self.entry(name).source}) or name its folder as a root in a file for --models"
            )
        found = self._hash(path)
        if sha256 is not None and found != sha256:
            raise ModelError(
                f"model '{name}': {path} has sha256 {found}, the registry says {sha256}; "
                "fetch the file again, or enter the new sum if the change is yours"
            )
        return path

    def _hash(self, path: Path) -> str:
        key = (path, path.stat().st_mtime_ns)
        if key not in self._hashes:
            self._hashes[key] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self._hashes[key]


def _outputs(name: str, variant: VariantEntry, model: Model) -> Mapping[str, OutputForm]:
    """The file's outputs by canonical name, checked against what the registry says of them."""
    forms = {}
    known = ", ".join(model.outputs)
    for canonical, entry in variant.outputs.items():
        native = entry.name
        if native is None and len(model.outputs) == 1:
            native = next(iter(model.outputs))
        if native is None or native not in model.outputs:
            raise ModelError(
                f"model '{name}': output '{canonical}' is named {native!r} in the registry; "
                f"the file has {known}"
            )
        stated = model.outputs[native]
        for key in ("shape", "dtype", "scale", "zero_point"):
            said, found = getattr(entry, key), getattr(stated, key)
            same = abs(said - found) < 1e-4 * found if key == "scale" and said else said == found
            if said is not None and not same:
                raise ModelError(
                    f"model '{name}': output '{canonical}' has {key} {found} in the file, "
                    f"{said} in the registry"
                )
        forms[canonical] = OutputForm(native, nchw=entry.layout == "nchw")
    return forms


def _read(path: Path) -> RegistryFile:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: is not YAML: {error}") from None
    try:
        return RegistryFile.model_validate(content or {})
    except ValidationError as error:
        mistakes = (
            f"{path}: {'.'.join(map(str, one['loc'])) or 'the file'}: {one['msg']}"
            for one in error.errors()
        )
        raise ModelError("\n".join(mistakes)) from None
