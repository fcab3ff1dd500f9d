"""The devices of a running graph: opened, loaded with every model that may run there, checked."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

from pipeline.drivers.isolated import IsolatedDevice
from pipeline.errors import DeviceError, ModelError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph, GraphDevice
from pipeline.measuring.profiler import Profiler
from pipeline.model import Accelerator, BoundModel, Probe


class Devices:
    """Owns every device that a ladder names; a context manager that closes them.

    The lower rungs are loaded and warmed up, too: a device that is lost is replaced within one run.
    """

    def __init__(self, graph: Graph, catalog: Catalog, profiler: Profiler) -> None:
        self._graph = graph
        self._catalog = catalog
        self._profiler = profiler
        self._stack = contextlib.ExitStack()
        self._devices: dict[str, Accelerator] = {}
        self._probes: dict[str, Probe] = {}
        self._models: dict[str, dict[str, BoundModel]] = {}  #: by stage, then device
        for stage in graph.stages:
            if stage.model is not None:
                self._models[stage.name] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def open(self, *, all_may_fail: bool = False) -> Mapping[str, str]:
        """Open and load every device; returns those that do not open, with the reason.

        Raises DeviceError where a stage has no device left, ModelError for a model that is wrong;
        with `all_may_fail`, as a replay has other outputs for such a stage, neither.
        """
        lost: dict[str, str] = {}
        for name in dict.fromkeys(rung for stage in self._graph.stages for rung in stage.ladder):
            self._devices[name] = make_device(self._graph.devices[name])
            self._stack.callback(self._devices[name].close)
            try:
                self.check(name)
            except DeviceError as error:
                lost[name] = str(error)
            except ModelError as error:
                if not all_may_fail:
                    raise
                lost[name] = str(error)
        for stage in self._graph.stages if not all_may_fail else ():
            if stage.model is not None and not self._models[stage.name]:
                reasons = "; ".join(f"{rung}: {lost[rung]}" for rung in stage.ladder)
                raise DeviceError(
                    f"stages.{stage.name}: no device of its executor opens ({reasons})"
                )
        return lost

    def models(self, stage: str) -> Mapping[str, BoundModel]:
        """A stage's model on each device of its ladder that opened; one that returns is added."""
        return self._models.get(stage, {})

    def describe(self) -> Mapping[str, Mapping[str, Any]]:
        """What each device is, as it said when it was asked last."""
        return {
            name: {
                "use": self._graph.devices[name].use,
                "is": probe.name,
                "runtime": probe.runtime,
                "isolated": self._graph.devices[name].isolation is not None,
            }
            for name, probe in self._probes.items()
        }

    def interrupt(self, name: str) -> None:
        """Free the thread that hangs in a device, where the device has a process to kill."""
        device = self._devices[name]
        if isinstance(device, IsolatedDevice):
            device.interrupt()

    def check(self, name: str) -> None:
        """Open a device (again) and load its models, warmed up. Raises DeviceError, ModelError."""
        device = self._devices[name]
        probe = self._probes[name] = device.probe()
        if not probe.available:
            raise DeviceError(probe.reason)
        users = [stage for stage in self._graph.stages if name in stage.ladder]
        needed = {stage.model for stage in users if stage.model is not None}
        child = device if isinstance(device, IsolatedDevice) else None
        with self._profiler.building(name, child):
            loaded = {model: self._catalog.load(model, device) for model in sorted(needed)}
        for stage in users:
            if stage.model is not None:
                self._models[stage.name][name] = loaded[stage.model]


def make_device(device: GraphDevice) -> Accelerator:
    """A fresh device of the file, in a process of its own where it says so; opens nothing."""
    if device.isolation is None:
        return device.make()
    return IsolatedDevice(device, device.isolation)
