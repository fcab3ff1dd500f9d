"""`overflight doctor`: a graph file against this machine, before the flight and not in it."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import psutil
import typer
from rich.console import Console

from accelerators.registry import Registry
from pipeline.drivers.devices import make_device
from pipeline.errors import ModelError, OverflightError
from pipeline.graph.graph import Graph, load_graph
from pipeline.model import Accelerator, BoundModel, Tensor
from tools.devices import summary

#: Runs that a warm model is timed with.
TIMED_RUNS = 5
#: A graph whose models take more of the free memory than this leaves too little for its maps.
MEMORY_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class DeviceState:
    """A device line of the file."""

    name: str
    use: str
    used: bool  #: a stage names it
    ready: bool
    what: str  #: name, runtime and driver; or why it is missing, with the way out


@dataclass(frozen=True, slots=True)
class ModelState:
    """A model on a device that some stage's ladder names."""

    model: str
    device: str
    file_ready: bool  #: there is a variant for the device, and its file is as the registry says
    ready: bool  #: and it ran
    what: str  #: its file; or what is wrong, with the way out
    infer_ms: float | None = None  #: median over runs on zeros, where it runs


@dataclass(frozen=True, slots=True)
class LadderState:
    """Where a stage will run."""

    stage: str
    rungs: tuple[str, ...]  #: as the file has them
    ready: tuple[str, ...]  #: those of them that can run its model


@dataclass(frozen=True, slots=True)
class Findings:
    """All that a graph needs of the machine."""

    devices: tuple[DeviceState, ...]
    models: tuple[ModelState, ...]
    ladders: tuple[LadderState, ...]
    hints: tuple[str, ...]  #: what works and could be better

    @property
    def ready(self) -> bool:
        """Whether everything that the stages name is there."""
        return all(one.ready for one in self.models)


def doctor_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    out: Path = Path("out"),
    as_json: bool = False,
) -> bool:
    """Examine a graph on this machine and print what is missing; True when nothing is.

    Raises GraphError where the file itself is wrong. A model file that is not here is no mistake of
    the graph, but a finding.
    """
    catalog = Registry.open(*models)
    graph = load_graph(
        path, catalog=_AnyFile(catalog), overlays=overlays, settings=settings, out=out
    )
    with Console(stderr=True).status("") as status:
        findings = examine(graph, catalog, status.update)
    if as_json:
        typer.echo(json.dumps({"ready": findings.ready, **asdict(findings)}, indent=2))
    else:
        _print(path, findings)
    return findings.ready


def examine(
    graph: Graph, catalog: Registry, progress: Callable[[str], None] = lambda text: None
) -> Findings:
    """Open every device of the file, and run every model on each device that its ladders name."""
    memory = psutil.Process().memory_info().rss
    with contextlib.ExitStack() as stack:
        planned = {name: device.make() for name, device in graph.devices.items()}
        devices: dict[str, Accelerator] = {}
        states = []
        used = {rung for stage in graph.stages for rung in stage.ladder}
        for name, device in graph.devices.items():
            progress(f"opening {name}")
            # A library that kills its process, as an unfit libedgetpu does, must not kill this one.
            devices[name] = make_device(device)
            stack.callback(devices[name].close)
            probe = devices[name].probe()
            state = DeviceState(name, device.use, name in used, probe.available, summary(probe))
            states.append(state)
        here = {one.name for one in states if one.ready}
        models: dict[tuple[str, str], ModelState] = {}
        loaded: list[BoundModel] = []  # kept until the memory is measured
        for stage in graph.stages:
            for rung in stage.ladder:
                if stage.model and (stage.model, rung) not in models:
                    progress(f"running {stage.model} on {rung}")
                    found = _check_file(stage.model, rung, planned[rung], catalog)
                    if found.file_ready and rung in here:
                        found = _run(found, devices[rung], catalog, loaded)
                    models[stage.model, rung] = found
        taken = psutil.Process().memory_info().rss - memory
        hints = _hints({name: planned[name] for name in sorted(here & used)}, taken)
    return Findings(tuple(states), tuple(models.values()), _ladders(graph, models), tuple(hints))


def _check_file(model: str, name: str, device: Accelerator, catalog: Registry) -> ModelState:
    """The variant for a device and its file, whether the device is here or not."""
    try:
        variant = catalog.variant(model, device)
        catalog.check_variant(model, variant)
    except ModelError as error:
        return ModelState(model, name, False, False, str(error))
    file = variant.file or f"{variant.kind}, without a file"
    return ModelState(model, name, True, False, file)


def _run(
    state: ModelState, device: Accelerator, catalog: Registry, loaded: list[BoundModel]
) -> ModelState:
    """Load and time a model on a device that is here."""
    try:
        loaded.append(catalog.load(state.model, device))
        took = _time(loaded[-1])
    except OverflightError as error:
        return replace(state, what=str(error))
    return replace(state, ready=True, infer_ms=took)


def _time(model: BoundModel) -> float:
    spec = model.spec
    zeros = np.zeros((1, *spec.input_shape), dtype=spec.input_dtype)
    native = model.encode({spec.input_name: Tensor(zeros)})
    took = []
    for _ in range(TIMED_RUNS):
        start = time.perf_counter()
        model.infer(native)
        took.append(time.perf_counter() - start)
    return round(median(took) * 1e3, 2)


def _ladders(graph: Graph, models: Mapping[tuple[str, str], ModelState]) -> tuple[LadderState, ...]:
    return tuple(
        LadderState(
            stage.name,
            stage.ladder,
            tuple(rung for rung in stage.ladder if models[stage.model, rung].ready),
        )
        for stage in graph.stages
        if stage.model
    )


def _hints(devices: Mapping[str, Any], taken: int) -> list[str]:
    hints = []
    threads = {name: device.threads for name, device in devices.items() if _on_cpu(device)}
    cores = len(os.sched_getaffinity(0))
    if sum(threads.values()) > cores:
        asked = ", ".join(f"{name} {count}" for name, count in threads.items())
        hints.append(
            f"the devices on the CPU ask for {sum(threads.values())} threads ({asked}), the "
            f"machine has {cores} cores: where they run at once they wait for each other; lower "
            "'threads'"
        )
    free = psutil.virtual_memory().available
    if taken > MEMORY_SHARE * (free + taken):
        hints.append(
            f"the models take {taken / 2**20:.0f} MiB of {(free + taken) / 2**20:.0f} MiB that "
            "were free; leave more for maps and queues, or run stages on another host"
        )
    return hints


def _on_cpu(device: Any) -> bool:
    """Whether a device computes on the host's cores: those have `threads`, GPUs a `device`."""
    return hasattr(device, "threads") and getattr(device, "device", "CPU") == "CPU"


def _print(path: Path, findings: Findings) -> None:
    for title, lines in (
        ("Devices", [_line(d.ready, d.name, "", d.what, d.used) for d in findings.devices]),
        (
            "Models",
            [
                _line(m.ready, f"{m.model} on {m.device}", _note(m, findings), m.what)
                for m in findings.models
            ],
        ),
        ("Stages", [f"  {one.stage}: {_runs_on(one)}" for one in findings.ladders]),
        ("Hints", [f"  {hint}" for hint in findings.hints]),
    ):
        if lines:
            typer.echo("\n".join([typer.style(title, bold=True), *lines, ""]))
    if findings.ready:
        typer.secho(f"{path}: everything that it names is here", fg=typer.colors.GREEN)
        return
    if not all(one.file_ready for one in findings.models):
        end = "it does not start before its model files are right"
    elif not all(one.ready for one in findings.ladders):
        end = "it cannot run here"
    else:
        end = "it runs, on lower rungs"
    typer.secho(f"{path}: something is missing; {end}", fg=typer.colors.RED)


def _line(ready: bool, name: str, note: str, what: str, used: bool = True) -> str:
    color = typer.colors.GREEN if ready else typer.colors.RED
    state = typer.style(f"{'ready' if ready else 'missing':7}", fg=color)
    words = [name, *([note] if note else []), *([] if used else ["no stage uses it"])]
    return f"  {state}  {', '.join(words)}\n           {what}"


def _note(model: ModelState, findings: Findings) -> str:
    if model.infer_ms is not None:
        return f"{model.infer_ms:.1f} ms a run"
    missing = {device.name for device in findings.devices if not device.ready}
    return "the device is missing" if model.file_ready and model.device in missing else ""


def _runs_on(ladder: LadderState) -> str:
    if not ladder.ready:
        return f"cannot run, on none of {', '.join(ladder.rungs)}"
    lost = [rung for rung in ladder.rungs if rung not in ladder.ready]
    return ", then ".join(ladder.ready) + (f" (not {', '.join(lost)})" if lost else "")


class _AnyFile:
    """A catalog that lets a graph name models whose files are not here."""

    def __init__(self, catalog: Registry) -> None:
        self.names = catalog.names
        self.spec = catalog.spec
        self.load = catalog.load

    def check(self, name: str, device: Accelerator) -> str | None:
        return None
