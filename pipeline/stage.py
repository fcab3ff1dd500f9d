"""What the author of a stage sees: Stage, Source, ModelStage and `ports`.

A stage is a plain class. `__init__` takes the options of the graph file and does no work; `open`
acquires, `close` releases. The named messages of `process` (of `prepare` with a model) are its
input ports and its return annotation is its output port `out`, or several ports when it is a frozen
dataclass marked `@ports`:

    Message[T]                        a required input
    Message[T] | None                 an input that may be missing
    tuple[Message[T] | None, ...]     a port that takes several edges, in the order of the file
    Span[T]                           every message around the set (``sync: span``)

A parameter with a default is a port that the file may leave without an edge.

A method returns a payload, which gets the trigger's stamp and extent; or a Message with its own
stamp, not below the trigger's; or None for "nothing to say" (an empty result is an empty payload,
not None).

When the framework calls what: `__init__` once when the graph is read (ValueError marks a bad
option), then `open` on the main thread, then the steps on worker threads, one at a time unless
`stateless`, then `close` on the main thread, also when `open` or a step failed. A raised exception
ends the run of that input set and, with ``on_error: stop``, the stage.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any, ClassVar, TypeVar

from pipeline.message import Message
from pipeline.model import BoundModel, ModelSpec

C = TypeVar("C", bound=type)


@dataclass(frozen=True, slots=True)
class Timing:
    """What a source can say of its stream before it runs; used by validation and planning."""

    rate_hz: float  #: nominal rate
    delay_ms: float = 0.0  #: usual arrival delay after the stamp
    jitter_ms: float = 0.0  #: half-width of the stamp's jitter around the nominal rate
    phase_ms: float | None = None  #: of the first stamp where it is fixed; None: it runs free
    extent_ms: float = 0.0  #: how far a capture's begin and end lie from its stamp


class Stage:
    """A unit of work; subclasses define ``process``."""

    #: Cheap and never blocks: runs on the thread that brings its trigger, without a hand-over.
    inline: ClassVar[bool] = False
    #: Keeps nothing between calls: several steps may run at once.
    stateless: ClassVar[bool] = False

    def open(self) -> None:
        """Acquire what the steps need; called once before the first step."""

    def close(self) -> None:
        """Release it; called once, whatever happened before. Sinks finish their files here."""

    def statistics(self) -> Mapping[str, float]:
        """What the stage counted by itself, for the report: read once, after the last step."""
        return {}

    def run_once(self, *inputs: Any, model: BoundModel | None = None) -> Any:
        """Open, run one input set, close: for tests and notebooks, without a graph."""
        try:
            self.open()
            return self.process(*inputs)  # type: ignore[attr-defined]
        finally:
            self.close()


class ModelStage(Stage):
    """A stage with a model: subclasses define ``prepare`` and ``finish``; the framework infers
    between them.

    ``prepare(self, <inputs>) -> Tensors`` gives the model's canonical input (see `ModelSpec`) and
    ``finish(self, outputs: Tensors, <inputs>)`` makes the result of its outputs.
    """

    #: The model that the graph file names, set before `open`.
    model: ModelSpec

    def run_once(self, *inputs: Any, model: BoundModel | None = None) -> Any:
        if model is None:
            raise TypeError(f"{type(self).__name__}.run_once needs model=...")
        self.model = model.spec
        try:
            self.open()
            tensors = self.prepare(*inputs)  # type: ignore[attr-defined]
            outputs = model.decode(model.infer(model.encode(tensors)))
            return self.finish(outputs, *inputs)  # type: ignore[attr-defined]
        finally:
            self.close()


class Source(Stage):
    """A stage without inputs: an iterator of messages, whose end ends the stream.

    Payload arrays are the receiver's to share: a source hands out arrays that it will not write
    again. A message's `stamp` is on the graph's clock; `received` says when it arrives at this host
    (a paced driver delivers it then, and records the instant at which it really did).
    """

    def messages(self) -> Iterator[Message[Any]]:
        """Subclasses narrow the annotation; ``Iterator[Message[Scan]]`` declares the payload."""
        raise NotImplementedError

    def timing(self) -> Timing | None:
        """Nominal rate and delay where they are known before the run."""
        return None

    def last_arrival(self) -> int | None:
        """When its last message arrives, where that is known once it is open: a recording's end.
        People are told by it how far a run has come; nothing else depends on it."""
        return None


def ports(cls: C) -> C:
    """Mark a frozen dataclass as a set of output ports: one per field, None = nothing on it."""
    if not is_dataclass(cls) or not cls.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise TypeError(f"@ports belongs on a frozen dataclass; {cls.__name__} is not one")
    cls.__ports__ = tuple(cls.__dataclass_fields__)  # type: ignore[attr-defined]
    return cls
