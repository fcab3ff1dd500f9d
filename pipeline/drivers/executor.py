"""Executes the steps that the scheduler starts: calls stages and models, packs what they return."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.drivers.sealing import seal
from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.model import BoundModel, Native, Tensors
from pipeline.scheduling.events import Output, Run, Step
from pipeline.scheduling.topology import StageNode
from pipeline.stage import Stage


class Pending:
    """What a step answers whose run ends later, when the driver is told (`LiveDriver.sent`)."""


PENDING = Pending()


class Executor(Protocol):
    """Executes the steps of one stage."""

    def execute(self, run: Run, step: Step) -> Sequence[Output] | Pending:
        """Run one step; returns what the run says after its last step, else nothing."""
        ...


@dataclass(slots=True)
class _Between:
    """What `prepare` leaves for `infer`, and `infer` for `finish`."""

    tensors: Tensors
    device: str  #: the device that `native` is encoded for, or came from
    native: Native


class Worker:
    """One stage's steps.

    Inputs go by name, so that a port which the file does not feed keeps its default. `models` holds
    the stage's model on every device of its ladder.
    """

    def __init__(
        self,
        node: StageNode,
        stage: Stage,
        models: Mapping[str, BoundModel] | None = None,
    ) -> None:
        self.node = node
        self.stage = stage
        self._models = {} if models is None else models  # grows as devices return
        self._names = [rule.name for rule in node.inputs]
        self._several = len(node.outputs) > 1 or node.outputs not in ((), ("out",))
        self._process: Callable[..., Any] | None = getattr(stage, "process", None)
        self._alone = self._names == _first_parameter(self._process)  #: no need to name it

    def execute(self, run: Run, step: Step) -> Sequence[Output]:
        """Run one step; returns what the run says after its last step, else nothing."""
        if step is Step.PROCESS:
            assert self._process is not None
            values = run.inputs.values
            if self._alone:
                return self._outputs(self._process(values[0]))
            by_name = dict(zip(self._names, values, strict=True))
            return self._outputs(self._process(**by_name))
        if step is Step.PREPARE:
            assert run.device is not None
            tensors = self._call("prepare", run)
            native = self._models[run.device].encode(tensors)
            run.result = _Between(tensors, run.device, native)
            return ()
        between: _Between = run.result
        if step is Step.INFER:
            assert run.device is not None
            model = self._models[run.device]
            if between.device != run.device:  # the run moved to another rung of its ladder
                between.device, between.native = run.device, model.encode(between.tensors)
            run.result = _Between(between.tensors, run.device, model.infer(between.native))
            return ()
        outputs = self._models[between.device].decode(between.native)
        run.result = None
        return self._outputs(self._call("finish", run, outputs))

    def _call(self, method: str, run: Run, *first: Any) -> Any:
        by_name = dict(zip(self._names, run.inputs.values, strict=True))
        return getattr(self.stage, method)(*first, **by_name)

    def _outputs(self, value: Any) -> Sequence[Output]:
        if value is None:
            return ()
        if not self.node.outputs:
            raise StageError(
                f"{type(self.stage).__name__} returned a {type(value).__name__}, but its "
                "annotation says None"
            )
        if not self._several:
            return (_output(0, value),)
        said = ((i, getattr(value, name)) for i, name in enumerate(self.node.outputs))
        return tuple(_output(i, payload) for i, payload in said if payload is not None)


def _first_parameter(function: Callable[..., Any] | None) -> list[str]:
    return list(inspect.signature(function).parameters)[:1] if function else []


def _output(port: int, value: Any) -> Output:
    if isinstance(value, Message):
        seal(value.payload)
        return Output(port, value.payload, value.stamp, value.begin, value.end)
    seal(value)
    return Output(port, value)
