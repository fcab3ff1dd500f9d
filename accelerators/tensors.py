"""A model of the registry bound to a device: canonical tensors in and out, the file's own inside.

Canonical is what stages see: (n, height, width, channels) in the dtype of the registry entry. A
file differs in normalization, quantization, layout and batch; all of that is here and runs on a CPU
worker (`encode`, `decode`), so that only `infer` holds the device.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DeviceError, ModelError
from pipeline.model import Model, ModelSpec, Native, Tensor, Tensors, TensorSpec

#: Canonical images (n, height, width, channels) in, the file's values out, same shape.
Convert: TypeAlias = Callable[[NDArray[Any]], NDArray[Any]]


@dataclass(frozen=True, slots=True)
class InputForm:
    """How a file wants its image: real = (value - mean) / std per channel, then quantized."""

    mean: tuple[float, ...] = (0.0,)
    std: tuple[float, ...] = (1.0,)
    nchw: bool = False
    reverse_channels: bool = False  #: the file takes BGR where the canonical input is RGB, or back


@dataclass(frozen=True, slots=True)
class OutputForm:
    """Where a canonical output is in the file, and its quantization where the file has none."""

    name: str
    nchw: bool = False
    scale: float = 1.0
    zero_point: int = 0


#: Element types of a file's input that an image can be converted to.
_INPUT_DTYPES = ("uint8", "int8", "uint16", "int16", "float16", "float32", "float64")


def file_input(
    spec: ModelSpec, form: InputForm, inputs: Mapping[str, TensorSpec]
) -> tuple[str, TensorSpec]:
    """The one input of a file; raises ModelError where an image of `spec` does not fit in."""
    if len(inputs) != 1:
        raise ModelError(
            f"model '{spec.name}': the file has the inputs {', '.join(inputs) or 'none'}; "
            "it must have one, an image"
        )
    name, stated = next(iter(inputs.items()))
    height, width, channels = spec.input_shape
    wanted = (channels, height, width) if form.nchw else (height, width, channels)
    sizes = stated.shape[1:]
    if len(sizes) != 3 or any(a not in (-1, b) for a, b in zip(sizes, wanted, strict=True)):
        raise ModelError(
            f"model '{spec.name}': the file's input is {stated.shape}, the registry says "
            f"(n, {', '.join(map(str, wanted))}); correct its 'input' or the variant's 'layout'"
        )
    if stated.dtype not in _INPUT_DTYPES:
        raise ModelError(
            f"model '{spec.name}': the file's input is {stated.dtype}; an image can be given as "
            f"{', '.join(_INPUT_DTYPES)}"
        )
    return name, stated


class BoundFile:
    """A `BoundModel`: one model file on one device. Only `infer` wants one thread at a time."""

    def __init__(
        self, spec: ModelSpec, model: Model, form: InputForm, outputs: Mapping[str, OutputForm]
    ) -> None:
        self.spec = spec
        self._model = model
        self._form = form
        self._outputs = outputs
        self._name, self._file = file_input(spec, form, model.inputs)
        dtype, channels = np.dtype(spec.input_dtype), spec.input_shape[2]
        self._convert = _converter(dtype, channels, form, self._file)

    def encode(self, tensors: Tensors) -> Native:
        """Canonical input to the file's own dtype and layout; (n, ...) stays (n, ...)."""
        array = tensors[self.spec.input_name].array
        if array.ndim != 4 or array.shape[1:] != self.spec.input_shape:
            raise ModelError(
                f"{self.spec.name}: takes (n, {', '.join(map(str, self.spec.input_shape))}), "
                f"not {array.shape}"
            )
        if array.dtype != self.spec.input_dtype:
            raise ModelError(f"{self.spec.name}: takes {self.spec.input_dtype}, not {array.dtype}")
        if self._form.reverse_channels:
            array = array[..., ::-1]
        array = self._convert(array)
        if self._form.nchw:
            array = array.transpose(0, 3, 1, 2)
        return {self._name: np.ascontiguousarray(array)}

    def infer(self, native: Native) -> Native:
        """Run the device; a file of batch 1 takes the images one after another."""
        images = native[self._name]
        if self._file.shape[0] in (-1, len(images)):
            return self._model.infer(native)
        if self._file.shape[0] != 1:
            raise DeviceError(
                f"{self.spec.name}: the file takes {self._file.shape[0]} images, not {len(images)}"
            )
        runs = [self._model.infer({self._name: images[i : i + 1]}) for i in range(len(images))]
        return {name: np.concatenate([run[name] for run in runs]) for name in runs[0]}

    def decode(self, native: Native) -> Tensors:
        """The file's outputs by canonical name, images as (n, height, width, channels) views."""
        tensors = {}
        for name, form in self._outputs.items():
            array, stated = native[form.name], self._model.outputs[form.name]
            if form.nchw:
                array = array.transpose(0, 2, 3, 1)
            known = stated if stated.scale else form
            tensors[name] = Tensor(array, known.scale, known.zero_point)
        return tensors

    def warm_up(self) -> None:
        """Run once on zeros, so that the first real frame does not pay for lazy set-up."""
        zeros = np.zeros((1, *self.spec.input_shape), dtype=self.spec.input_dtype)
        self.decode(self.infer(self.encode({self.spec.input_name: Tensor(zeros)})))


class _Affine:
    """value * gain + shift per channel, rounded and clipped where the file holds integers."""

    def __init__(self, gain: NDArray[np.float64], shift: NDArray[np.float64], dtype: Any) -> None:
        self._gain, self._shift = gain.astype(np.float32), shift.astype(np.float32)
        self._dtype = np.dtype(dtype)

    def __call__(self, array: NDArray[Any]) -> NDArray[Any]:
        values = array * self._gain
        values += self._shift
        if self._dtype.kind in "iu":
            limits = np.iinfo(self._dtype)
            np.clip(np.rint(values, out=values), limits.min, limits.max, out=values)
        return values.astype(self._dtype, copy=False)


class _Lookup:
    """The same for 8-bit images into integers: one table per channel instead of arithmetic."""

    def __init__(self, affine: _Affine, dtype: np.dtype[Any], channels: int) -> None:
        self._low = np.iinfo(dtype).min
        values = np.arange(256, dtype=np.int32) + self._low
        every = np.broadcast_to(values.astype(dtype)[:, None], (256, channels))
        self._tables = np.ascontiguousarray(affine(every).T)
        self._alike = bool((self._tables == self._tables[0]).all())

    def __call__(self, array: NDArray[Any]) -> NDArray[Any]:
        index = array if self._low == 0 else array.astype(np.int16) - self._low
        if self._alike:
            return np.asarray(self._tables[0].take(index))
        planes = [table.take(index[..., i]) for i, table in enumerate(self._tables)]
        return np.stack(planes, axis=-1)


def _identity(array: NDArray[Any]) -> NDArray[Any]:
    return array


def _converter(dtype: np.dtype[Any], channels: int, form: InputForm, file: TensorSpec) -> Convert:
    """What turns canonical values into the file's: nothing, a table, or arithmetic.

    real = (value - mean) / std and, in a quantized file, stored = real / scale + zero_point, so
    stored = value * gain + shift with both known at load.
    """
    step = file.scale or 1.0
    std = np.broadcast_to(np.asarray(form.std, dtype=np.float64), (channels,))
    mean = np.broadcast_to(np.asarray(form.mean, dtype=np.float64), (channels,))
    gain = 1.0 / (std * step)
    shift = file.zero_point - mean * gain
    stored = np.dtype(file.dtype)
    whole = stored.kind in "iu"
    # Half a thousandth of a count over the 8-bit range is what float32 scales in files leave.
    exact = np.allclose(gain, 1.0, atol=2e-6) and np.allclose(shift, 0.0, atol=5e-4)
    if exact and stored == dtype:
        return _identity
    affine = _Affine(gain, shift, stored)
    return _Lookup(affine, dtype, channels) if whole and dtype.itemsize == 1 else affine
