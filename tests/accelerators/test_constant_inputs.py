from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from accelerators.constant_inputs import ConstantInputs
from pipeline.errors import ModelError
from pipeline.model import Native, TensorSpec


class Recurrent:
    """An image and a state in, their sum out."""

    inputs: Mapping[str, TensorSpec] = {
        "image": TensorSpec((1, 2), "uint8"),
        "state": TensorSpec((1, 2), "int8"),
        "open": TensorSpec((-1, 2), "int8"),
    }
    outputs: Mapping[str, TensorSpec] = {"sum": TensorSpec((1, 2), "int16")}

    def infer(self, inputs: Native) -> Native:
        assert inputs["state"].dtype == np.int8
        return {"sum": inputs["image"].astype(np.int16) + inputs["state"]}


def test_what_is_held_at_a_value_is_no_input_any_more() -> None:
    model = ConstantInputs(Recurrent(), {"state": -3}, "net")
    assert list(model.inputs) == ["image", "open"]
    assert model.outputs == Recurrent.outputs
    found = model.infer({"image": np.array([[5, 7]], np.uint8)})
    assert found["sum"].tolist() == [[2, 4]]


@pytest.mark.parametrize("name", ["stat", "open"])
def test_an_input_that_is_not_there_or_not_of_a_fixed_shape_is_refused(name: str) -> None:
    said = f"model 'net': constants: the file has no input '{name}' of a fixed shape; its inputs"
    with pytest.raises(ModelError, match=said):
        ConstantInputs(Recurrent(), {name: 0}, "net")
