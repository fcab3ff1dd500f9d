"""A model file with further inputs, held at one value each: all that is left is the image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.errors import ModelError
from pipeline.model import Model, Native


class ConstantInputs:
    """A model without the inputs that `constants` fills, each with one number as it is stored.

    For a recurrent network whose state shall be that of a first frame, or a switch of the file.
    `name` is the registry's, for the ModelError where the file has no such input or leaves its
    shape open.
    """

    def __init__(self, model: Model, constants: Mapping[str, float], name: str) -> None:
        for key in constants:
            if key not in model.inputs or min(model.inputs[key].shape, default=0) < 0:
                raise ModelError(
                    f"model '{name}': constants: the file has no input '{key}' of a fixed shape; "
                    f"its inputs are {', '.join(model.inputs)}"
                )
        self._model = model
        self._fixed = {
            key: np.full(model.inputs[key].shape, value, model.inputs[key].dtype)
            for key, value in constants.items()
        }
        self.inputs = {key: spec for key, spec in model.inputs.items() if key not in constants}
        self.outputs = model.outputs

    def infer(self, inputs: Native) -> Native:
        return self._model.infer({**inputs, **self._fixed})
