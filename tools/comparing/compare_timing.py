"""How long each run of a model takes its device, without the driver's knowledge of it.

A driver measures CPU, and in a run as fast as possible nothing else has a meaning. What a person
wants to know of a device before a swap is measured here, around the models of the catalog.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType

from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph, GraphDevice
from pipeline.measuring.quantiles import Quantiles
from pipeline.model import Accelerator, BoundModel, ModelSpec, Native, Tensors


@dataclass(slots=True)
class Timer:
    """How long each run of a model takes its device, ns, by model and device."""

    device: str = ""  #: made last; its models are loaded before the next one is made
    took: dict[tuple[str, str], Quantiles] = field(default_factory=dict)


@dataclass(frozen=True)
class TimedDevice(GraphDevice):
    """A device of the graph that says when it is made, in this process or for one of its own."""

    timer: Timer = field(default_factory=Timer)

    def make(self) -> Accelerator:
        self.timer.device = self.name
        return super().make()


class TimedCatalog:
    """A catalog whose models note how long each of their runs takes the device."""

    def __init__(self, catalog: Catalog, timer: Timer) -> None:
        self._catalog = catalog
        self._timer = timer
        self.names = catalog.names
        self.spec: Callable[[str], ModelSpec] = catalog.spec
        self.check = catalog.check

    def load(self, name: str, device: Accelerator) -> BoundModel:
        took = self._timer.took[name, self._timer.device] = Quantiles()
        return TimedModel(self._catalog.load(name, device), took)


class TimedModel:
    """A model that notes how long `infer` takes, ns."""

    def __init__(self, model: BoundModel, took: Quantiles) -> None:
        self._model = model
        self._took = took
        self.spec = model.spec
        self.encode: Callable[[Tensors], Native] = model.encode
        self.decode: Callable[[Native], Tensors] = model.decode

    def infer(self, native: Native) -> Native:
        start = time.perf_counter_ns()
        outputs = self._model.infer(native)
        self._took.add(time.perf_counter_ns() - start)
        return outputs


def timed(graph: Graph, catalog: Catalog, timer: Timer) -> tuple[Graph, Catalog]:
    """The same graph and catalog, whose models tell the timer of their runs."""
    devices = {
        name: TimedDevice(
            **{one.name: getattr(device, one.name) for one in fields(device)}, timer=timer
        )
        for name, device in graph.devices.items()
    }
    graph = replace(graph, devices=MappingProxyType(dict(devices)))
    return graph, TimedCatalog(catalog, timer)
