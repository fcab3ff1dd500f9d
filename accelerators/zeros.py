"""The stand-in for a network that is not there: zeros in the shapes that the registry declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Native, TensorSpec


class Zeros:
    """The declared shapes of a model; outputs are made once and shared, read-only."""

    def __init__(self, variant: Mapping[str, Any]) -> None:
        image = variant["input"]
        self.inputs: Mapping[str, TensorSpec] = {
            image["name"]: TensorSpec((1, *image["shape"]), image["dtype"])
        }
        self.outputs: Mapping[str, TensorSpec] = {
            name: _spec(variant["model"], name, output)
            for name, output in variant["outputs"].items()
        }
        self._arrays = {
            name: np.zeros(spec.shape, dtype=spec.dtype) for name, spec in self.outputs.items()
        }
        for array in self._arrays.values():
            array.flags.writeable = False

    def infer(self, inputs: Native) -> Native:
        for name, spec in self.inputs.items():
            given = inputs[name]
            if given.shape != spec.shape or given.dtype != spec.dtype:
                raise DeviceError(
                    f"emulated: input '{name}' takes {spec.dtype} {spec.shape}, "
                    f"not {given.dtype} {given.shape}"
                )
        return dict(self._arrays)


def _spec(model: str, name: str, output: Mapping[str, Any]) -> TensorSpec:
    if "shape" not in output:
        raise ModelError(f"model '{model}': the emulated output '{name}' needs a shape")
    return TensorSpec(
        tuple(output["shape"]),
        output.get("dtype", "float32"),
        output.get("scale", 0.0),
        output.get("zero_point", 0),
    )
