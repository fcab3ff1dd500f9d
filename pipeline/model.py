"""The narrow waist to models and devices: what a stage, an accelerator and the framework share.

A stage prepares and finishes in canonical form (NHWC; see `ModelSpec`), so that the device of a run
can change without the stage knowing. `BoundModel.encode` and `decode` hold what differs between the
files of one model (normalization, quantization, layout) and run on a CPU worker; only `infer` holds
the device.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Tensor:
    """An array and its quantisation: value = (array - zero_point) * scale."""

    array: NDArray[Any]
    scale: float = 1.0
    zero_point: int = 0

    def values(self) -> NDArray[np.float32]:
        """The dequantised values as float32, same shape."""
        if self.scale == 1.0 and self.zero_point == 0:
            return self.array.astype(np.float32, copy=False)
        return (self.array.astype(np.float32) - np.float32(self.zero_point)) * np.float32(
            self.scale
        )


#: What goes into a model and comes out of it, by name. Images are (n, height, width, channels).
Tensors: TypeAlias = Mapping[str, Tensor]

#: The same in the form that one model file takes: its own dtype, layout and batch.
Native: TypeAlias = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class TensorSpec:
    """One input or output of a model file, as the file states it."""

    shape: tuple[int, ...]  #: -1 where the file leaves a dimension open
    dtype: str  #: numpy's name of the element type
    scale: float = 0.0  #: 0 where the tensor is not quantised
    zero_point: int = 0


@dataclass(frozen=True, slots=True)
class ModelSpec:
    """What every variant of a model has in common, as a stage sees it."""

    name: str
    input_name: str  #: the canonical input's name in `Tensors`
    input_shape: tuple[int, ...]  #: canonical, without batch: (height, width, channels)
    input_dtype: str  #: canonical dtype, e.g. "uint8" for images 0..255
    color: str  #: channel order that `prepare` must give: "rgb", "bgr", "gray" or "" for no image
    head: Mapping[str, Any] = field(default_factory=dict)  #: kind of output and its settings


class Model(Protocol):
    """A model file on a device, in the file's own terms. One thread at a time."""

    @property
    def inputs(self) -> Mapping[str, TensorSpec]: ...

    @property
    def outputs(self) -> Mapping[str, TensorSpec]: ...

    def infer(self, inputs: Native) -> Native:
        """Run once; the returned arrays are the caller's own. Raises DeviceError."""
        ...


class BoundModel(Protocol):
    """A model of the registry on a device, ready to run."""

    @property
    def spec(self) -> ModelSpec: ...

    def encode(self, tensors: Tensors) -> Native: ...

    def infer(self, native: Native) -> Native: ...

    def decode(self, native: Native) -> Tensors: ...


@dataclass(frozen=True, slots=True)
class Probe:
    """What a device says of itself before anything is loaded."""

    available: bool
    name: str  #: what the runtime calls the device; empty when it is not available
    runtime: str  #: runtime and version
    reason: str = ""  #: why it is not available, with the one thing to do about it
    driver: str = ""  #: kernel or vendor driver and version, where the device has one


class Accelerator(Protocol):
    """A device of the graph file. `__init__` takes the options of its block and opens nothing.

    A class whose library may crash or hang says `isolate = True`: it then runs in a process of its
    own unless the file says otherwise.
    """

    #: Variant kinds this class can run, best first: "tflite", "openvino", "onnx", "emulated" ...
    kinds: tuple[str, ...]

    def probe(self) -> Probe: ...

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        """Load one model file; `variant` is its registry entry. Raises ModelError, DeviceError."""
        ...

    def close(self) -> None: ...
