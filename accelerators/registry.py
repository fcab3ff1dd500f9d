"""The models a graph may name: read from models.yaml, verified, loaded and bound to a device.

Several registry files add up: a later one may replace a model of the same name, and its roots are
searched too, so a registry of nothing but `roots:` says where downloaded files lie.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from accelerators.constant_inputs import ConstantInputs
from accelerators.fitting import check_file, input_form, output_forms
from accelerators.registry_file import (
    SHIPPED,
    ModelEntry,
    RegistryFile,
    VariantEntry,
    read_registry,
)
from accelerators.tensors import BoundFile
from pipeline.errors import ModelError
from pipeline.model import Accelerator, BoundModel, ModelSpec


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
            file = read_registry(path)
            models.update(file.models)
            roots.extend(path.parent / root for root in file.roots)
        return cls(models, roots)

    @classmethod
    def of(cls, file: RegistryFile, folder: Path) -> Registry:
        """One registry file alone, as if it lay in `folder`."""
        return cls(file.models, [folder / root for root in file.roots])

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
            self.check_variant(name, self.variant(name, device))
        except ModelError as error:
            return str(error)
        return None

    def check_variant(self, name: str, variant: VariantEntry) -> None:
        """Hold a variant's files against its entry, sums included, without a runtime.

        Raises ModelError with the way out.
        """
        path, _ = self.files(name, variant)
        if path is not None:
            check_file(self.spec(name), variant, path)

    def load(
        self, name: str, device: Accelerator, variant: VariantEntry | None = None
    ) -> BoundModel:
        """The model on a device, warmed up; of its variants the one that the device likes best."""
        variant = variant or self.variant(name, device)
        path, weights = self.files(name, variant)
        spec = self.spec(name)
        settings: dict[str, Any] = variant.model_dump(exclude_none=True)
        settings |= {"model": name, "input": self.entry(name).input.model_dump()}
        if weights:
            settings["weights"] = str(weights)
        model = device.load(str(path or ""), settings)
        if variant.constants:
            model = ConstantInputs(model, variant.constants, name)
        outputs = output_forms(name, variant, model.outputs)
        bound = BoundFile(spec, model, input_form(spec, variant), outputs)
        bound.warm_up()
        return bound

    def variant(self, name: str, device: Accelerator) -> VariantEntry:
        """The first variant of the kind that the device likes best."""
        variants = self.entry(name).variants
        for kind in device.kinds:
            for variant in variants:
                if variant.kind == kind:
                    return variant
        kinds = [variant.kind for variant in variants]
        way_out = "add such a file with 'overflight models add'"
        if "onnx" in device.kinds and "tflite" in kinds:
            way_out = f"make an .onnx with 'overflight models convert {name}' (see its --help)"
        raise ModelError(
            f"model '{name}' has no variant for {type(device).__name__}, which runs "
            f"{' or '.join(device.kinds)}; it has {', '.join(kinds)}. "
            f"Name another device, or {way_out}"
        )

    def files(self, name: str, variant: VariantEntry) -> tuple[Path | None, Path | None]:
        """The verified model file and weights file of a variant, where it has them.

        Raises ModelError where one is not there or is another than the entry says.
        """
        return (
            self._verified(name, variant.file, variant.sha256),
            self._verified(name, variant.weights, variant.weights_sha256),
        )

    def _verified(self, name: str, file: str | None, sha256: str | None) -> Path | None:
        if file is None:
            return None
        path = self.find(file)
        if path is None:
            places = ", ".join(str(root.resolve()) for root in self._roots)
            raise ModelError(
                f"model '{name}': no file {file} in {places}; put it there (source: "
                f"{self.entry(name).source}) or name its folder as a root in a file for --models"
            )
        # Two registries may have files of one name: that of the sum is meant, whichever lies first.
        path = next((one for one in self._places(file) if self._hash(one) == sha256), path)
        found = self._hash(path)
        if sha256 is not None and found != sha256:
            raise ModelError(
                f"model '{name}': {path} has sha256 {found}, the registry says {sha256}; "
                "fetch the file again, or enter the new sum if the change is yours"
            )
        return path

    def find(self, file: str) -> Path | None:
        """Where a file of a variant lies; None where no root has it."""
        return next(self._places(file), None)

    def _places(self, file: str) -> Iterator[Path]:
        """Every file of that name, by the order of the roots."""
        paths = ((root / file).resolve() for root in self._roots)
        return (path for path in paths if path.is_file())

    def _hash(self, path: Path) -> str:
        key = (path, path.stat().st_mtime_ns)
        if key not in self._hashes:
            self._hashes[key] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self._hashes[key]
