"""`overflight devices`: what this machine can run models on, and what to install for the rest."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import psutil
import typer

import accelerators
from pipeline.model import Probe
from tools.bench.machine import cpu_model


@dataclass(frozen=True, slots=True)
class Found:
    """One device line that a graph file could hold, and what the machine says to it."""

    use: str  #: ``module:Class``
    options: Mapping[str, Any]
    probe: Probe

    def line(self) -> str:
        """As a graph file writes it."""
        words = [f"use: {self.use}", *(f"{key}: {value}" for key, value in self.options.items())]
        return f"{{{', '.join(words)}}}"


def find_devices() -> list[Found]:
    """Ask every accelerator that ships for the device lines worth a try here, and probe each.

    An accelerator offers them by a class method `candidates`; one without it is no hardware.
    """
    found = []
    for module in pkgutil.iter_modules(accelerators.__path__, "accelerators."):
        for cls in vars(importlib.import_module(module.name)).values():
            if hasattr(cls, "candidates") and cls.__module__ == module.name:
                for options in cls.candidates():
                    device = cls(**options)
                    found.append(Found(f"{module.name}:{cls.__name__}", options, device.probe()))
                    device.close()
    return found


def print_devices(*, as_json: bool) -> None:
    """Print what is here, and for what is not the one thing to do."""
    devices = find_devices()
    machine = _machine()
    if as_json:
        values = {"machine": machine, "devices": [_values(one) for one in devices]}
        typer.echo(json.dumps(values, indent=2))
        return
    size = f"{machine['cores']} cores, {machine['memory_gib']} GiB"
    typer.echo(f"{machine['cpu']}, {size}, {machine['kernel']}, Python {machine['python']}")
    for title, available in (("Ready", True), ("Not here", False)):
        found = [one for one in devices if one.probe.available is available]
        if found:
            typer.secho(f"\n{title}", bold=True)
        for one in found:
            typer.echo(f"  {one.line()}\n      {summary(one.probe)}")
    typer.echo("\nFor a device that is not here, accelerators.emulated:Emulated takes its time.")


def summary(probe: Probe) -> str:
    """The device with its runtime and driver, or why it is missing."""
    if not probe.available:
        return probe.reason
    return ", ".join(word for word in (probe.name, probe.runtime, probe.driver) if word)


def _values(found: Found) -> dict[str, Any]:
    probe = found.probe
    return {
        "use": found.use,
        "options": dict(found.options),
        "available": probe.available,
        "name": probe.name,
        "runtime": probe.runtime,
        "driver": probe.driver,
        "missing": probe.reason,
    }


def _machine() -> dict[str, Any]:
    return {
        "cpu": cpu_model(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
