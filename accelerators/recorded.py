"""Keeps what a network answered, and answers again without it: outputs from a recorded run.

An answer is found by what was asked, bit by bit: a frame that was not recorded is refused, whatever
frames a run drops. So a graph can be replayed where neither the device nor the time to compute is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Accelerator, Model, Native, Probe, TensorSpec

_INDEX = "models.json"


class Record:
    """Runs models on `device`, a device block of its own, and keeps every answer in folder `path`.

    Writing takes time on the device: record offline (`--speed max`), then measure with `Recorded`.
    """

    kinds: tuple[str, ...] = ()  #: those of the device

    def __init__(self, *, device: Accelerator, path: Path) -> None:
        self.kinds = device.kinds
        self._device = device
        self._path = path

    def probe(self) -> Probe:
        return self._device.probe()

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        model = self._device.load(path, variant)
        name, probe = str(variant["model"]), self._device.probe()
        folder = self._path / name
        folder.mkdir(parents=True, exist_ok=True)
        entry = {
            "kind": variant["kind"],
            "by": f"{probe.runtime} on {probe.name}",
            "inputs": {key: asdict(spec) for key, spec in model.inputs.items()},
            "outputs": {key: asdict(spec) for key, spec in model.outputs.items()},
        }
        index = _read_index(self._path) if (self._path / _INDEX).is_file() else {}
        (self._path / _INDEX).write_text(json.dumps({**index, name: entry}, indent=2) + "\n")
        return _Recording(model, folder)

    def close(self) -> None:
        self._device.close()


class Recorded:
    """Answers from the folder `path` that a `Record` filled; needs the model files, not a runtime
    for them."""

    kinds: tuple[str, ...] = ()  #: those that were recorded

    def __init__(self, *, path: Path) -> None:
        self._path = path
        self._index = _read_index(path)
        self.kinds = tuple(dict.fromkeys(entry["kind"] for entry in self._index.values()))

    def probe(self) -> Probe:
        by = ", ".join(dict.fromkeys(entry["by"] for entry in self._index.values()))
        return Probe(True, "recorded", f"recorded answers of {by or 'nothing'}")

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        name = str(variant["model"])
        entry = self._index.get(name)
        if entry is None or entry["kind"] != variant["kind"]:
            known = ", ".join(self._index) or "nothing"
            raise ModelError(f"{self._path}: no answers of model '{name}', only of {known}")
        return _Replay(self._path / name, _specs(entry["inputs"]), _specs(entry["outputs"]))

    def close(self) -> None:
        """Nothing is held."""


class _Recording:
    """A model whose answers are kept, one file per question."""

    def __init__(self, model: Model, folder: Path) -> None:
        self.inputs, self.outputs = model.inputs, model.outputs
        self._model = model
        self._folder = folder

    def infer(self, inputs: Native) -> Native:
        found = self._model.infer(inputs)
        path = self._folder / f"{_digest(inputs)}.npz"
        if not path.exists():
            answer = [found[name] for name in self.outputs]
            half = path.with_suffix(".half")  # so that a run that is cut off leaves whole files
            with half.open("wb") as file:
                np.savez(file, *answer)
            half.rename(path)
        return found


class _Replay:
    """A model that finds its answers."""

    def __init__(
        self, folder: Path, inputs: Mapping[str, TensorSpec], outputs: Mapping[str, TensorSpec]
    ) -> None:
        self.inputs, self.outputs = inputs, outputs
        self._folder = folder

    def infer(self, inputs: Native) -> Native:
        try:
            with np.load(self._folder / f"{_digest(inputs)}.npz") as file:
                return {name: file[f"arr_{i}"] for i, name in enumerate(self.outputs)}
        except OSError:
            raise DeviceError(
                f"{self._folder}: this input was not recorded; record the run again with "
                "accelerators.recorded:Record, with every frame (--speed max)"
            ) from None


def _digest(inputs: Native) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for name, array in sorted(inputs.items()):
        digest.update(f"{name} {array.dtype} {array.shape};".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _read_index(path: Path) -> dict[str, Any]:
    try:
        index: dict[str, Any] = json.loads((path / _INDEX).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ModelError(
            f"path {path} holds no recorded answers; record some with accelerators.recorded:Record"
        ) from None
    return index


def _specs(entries: Mapping[str, Any]) -> Mapping[str, TensorSpec]:
    return {
        name: TensorSpec(**{**entry, "shape": tuple(entry["shape"])})
        for name, entry in entries.items()
    }
