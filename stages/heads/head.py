"""What all heads have in common: settings of the registry in, a decoder of the outputs out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.errors import ModelError
from pipeline.model import Tensor, Tensors
from stages.kernels.boxes import Found

#: What finds the candidates in the outputs of one run.
Decoder: TypeAlias = Callable[[Tensors], Found]


class Settings(BaseModel):
    """A block of the registry that a head understands: unknown keys are mistakes."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Head(Settings):
    """One kind of detector output; the fields are the keys of the model's `head` block.

    A head looks through scores in the numbers as the file stores them and dequantizes only what may
    be good enough, so that an 8-bit output is never copied as a whole.
    """

    kind: str
    class_map: dict[int, str] = {}  #: the model's class: our class name
    letterbox: bool = False  #: the picture keeps the image's aspect, gray around it

    def decoder(self, picture: tuple[int, int], min_score: float) -> Decoder:
        """What decodes a run on a `picture` (width, height); candidates below `min_score` may be
        among the found. The decoder raises ModelError for outputs of another shape."""
        raise NotImplementedError


def output(outputs: Tensors, name: str, *shape: int) -> Tensor:
    """The named output of one picture as an array of `shape`, -1 for any length; without `shape` as
    it is, less its first dimension (the batch of one).

    Raises ModelError where the registry names no such output or it cannot have that shape.
    """
    if name not in outputs:
        known = ", ".join(outputs) or "none"
        raise ModelError(f"the head needs an output '{name}', the registry names {known}")
    tensor = outputs[name]
    try:
        array = tensor.array.reshape(shape or tensor.array.shape[1:])
    except ValueError:
        wanted = ", ".join("n" if length == -1 else str(length) for length in shape)
        raise wrong_shape(name, tensor, wanted or "one picture at a time") from None
    return Tensor(array, tensor.scale, tensor.zero_point)


def output_map(outputs: Tensors, name: str, least_channels: int) -> Tensor:
    """The named output of one picture as (rows, columns, channels). Raises ModelError."""
    tensor = output(outputs, name)
    if tensor.array.ndim != 3 or tensor.array.shape[2] < least_channels:
        raise wrong_shape(name, tensor, f"rows, columns, {least_channels} or more")
    return tensor


def wrong_shape(name: str, tensor: Tensor, wanted: str) -> ModelError:
    """An output that is not of the head's kind, or not what its settings say."""
    return ModelError(
        f"output '{name}' has shape {tensor.array.shape}, the head takes ({wanted}); check the "
        "head's settings and the outputs in the model's registry entry"
    )


def rows(tensor: Tensor, index: Any) -> NDArray[np.float32]:
    """The dequantized values of some rows of a tensor."""
    return Tensor(tensor.array[index], tensor.scale, tensor.zero_point).values()
