"""A device in a process of its own: what it costs when its library crashes or hangs is one run.

`IsolatedDevice` is an `Accelerator` like the one it stands for, which lives in a child process
(`isolated_child`). Tensors go through shared memory: two copies per run. A lost process is an error
of the run; the next `probe` starts it anew, by the rules of the graph file, and the models are
loaded again by whoever probed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from pipeline.errors import DeviceError, ModelError
from pipeline.graph.blocks import pack
from pipeline.graph.graph import GraphDevice
from pipeline.model import Model, Native, Probe, TensorSpec
from pipeline.transport.child import Child, Restarts
from pipeline.transport.mailbox import Arrays, Closed

#: Errors that keep their kind on the way from the child; any other becomes a DeviceError.
KINDS = {"DeviceError": DeviceError, "ModelError": ModelError}

MODULE = "pipeline.drivers.isolated_child"


class IsolatedDevice:
    """The device of a block of the file, behind a process boundary."""

    def __init__(self, device: GraphDevice, restarts: Restarts) -> None:
        self.kinds = device.make().kinds  # an option may change them
        self._device = device
        self._child = Child(device.name, MODULE, restarts)
        self._opened: int | None = None  #: the process that was told what it is
        self._waiting = False

    @property
    def pid(self) -> int | None:
        """The process that the device lives in; None before the first probe."""
        return self._child.pid

    def probe(self) -> Probe:
        try:
            answer, _ = self._call({"call": "probe"})
        except DeviceError as error:
            return Probe(False, "", "", str(error))
        return Probe(**answer["probe"])

    def load(self, path: str, variant: Mapping[str, Any]) -> Model:
        answer, _ = self._call({"call": "load", "path": path, "variant": dict(variant)})
        return IsolatedModel(self, self._opened, answer)

    def infer(self, process: int | None, number: int, inputs: Native) -> Native:
        """Run a model that `process` loaded. Raises DeviceError, also where that is gone."""
        if process != self._child.pid:  # the one of now is well, and is left alone
            raise DeviceError(
                f"devices.{self._device.name}: the process that loaded this model is gone; it was "
                "started anew since"
            )
        if not self._child.alive:
            raise DeviceError(f"devices.{self._device.name}: {self._loss()}")
        return self._call({"call": "infer", "model": number}, inputs)[1]

    def interrupt(self) -> None:
        """Kill the process if a call hangs in it; that call raises DeviceError."""
        if self._waiting:
            self._child.kill()

    def close(self) -> None:
        self._child.close()

    def _call(
        self, header: Mapping[str, Any], arrays: Arrays | None = None
    ) -> tuple[dict[str, Any], Native]:
        """Ask the child and wait. Raises DeviceError, ModelError."""
        mailbox = self._child.mailbox()
        self._waiting = True
        try:
            if self._opened != self._child.pid:
                block = pack(self._device.block)
                mailbox.send({"path": sys.path, "use": self._device.use, "block": block})
                _raise(mailbox.receive()[0])
                self._opened = self._child.pid
            mailbox.send(header, arrays)
            answer, outputs = mailbox.receive()
        except Closed:
            raise DeviceError(f"devices.{self._device.name}: {self._loss()}") from None
        finally:
            self._waiting = False
        _raise(answer)
        return answer, outputs

    def _loss(self) -> str:
        how = self._child.how_it_ended()
        self._child.kill()  # where it only closed its end
        return f"its process {how}"


class IsolatedModel:
    """A model in the device's process. Goes with it: after a restart it must be loaded again."""

    def __init__(
        self, device: IsolatedDevice, process: int | None, answer: Mapping[str, Any]
    ) -> None:
        self._device = device
        self._process = process
        self._number: int = answer["model"]
        self.inputs = _specs(answer["inputs"])
        self.outputs = _specs(answer["outputs"])

    def infer(self, inputs: Native) -> Native:
        return self._device.infer(self._process, self._number, inputs)


def _specs(said: Mapping[str, Any]) -> Mapping[str, TensorSpec]:
    return {name: TensorSpec(tuple(shape), *rest) for name, (shape, *rest) in said.items()}


def _raise(answer: Mapping[str, Any]) -> None:
    if "error" in answer:
        raise KINDS.get(answer["error"], DeviceError)(answer["text"])
