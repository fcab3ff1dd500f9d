"""Gathers what a plan needs to know: when sensors speak, and what each stage costs where it could
run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from accelerators.latencies import column
from pipeline.errors import DataError, OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph, GraphStage
from pipeline.measuring.costs import Costs, Machine, SourceCost, Spread, StageCost
from pipeline.stage import Source

#: Whose measurements stand in for a device that is not at hand: ``paper.<device>``.
SHIPPED = "paper"

#: What a source may know of its stamps that no profile measures.
FIXED = ("phase_ms", "extent_ms")


@dataclass(frozen=True, slots=True)
class Known:
    """All that is known before planning."""

    costs: Costs
    choices: Mapping[str, tuple[str, ...]]  #: by stage with a model: devices, the file's first
    notes: tuple[str, ...]  #: what is assumed, for people


def gather(graph: Graph, catalog: Catalog, table: Costs | None, cores: int) -> Known:
    """What `table` holds comes first; then what the file and the shipped latencies say.

    Raises DataError where a sensor's rate or the time of a network is not known.
    """
    table = table or Costs(machine=Machine(cores=cores))
    notes: list[str] = []
    found = [*table.costs]
    choices: dict[str, tuple[str, ...]] = {}
    timeless: list[str] = []
    for stage in graph.stages:
        if stage.model is not None:
            able = _able(graph, catalog, stage, stage.model)
            costs = _on_each_device(graph, table, stage, stage.model, able)
            if not costs:
                raise DataError(
                    f"stages.{stage.name}: how long '{stage.model}' takes on {' or '.join(able)} "
                    f"is not known; measure it (overflight profile {graph.file} --save-costs "
                    "costs.yaml) and give the file with --costs"
                )
            choices[stage.name] = tuple(costs)
            found += [cost for cost in costs.values() if cost not in found]
            timeless += [f"{stage.name} on {name}" for name in able if name not in costs]
    if timeless:
        notes.append(f"Not considered, as no time is known: {', '.join(timeless)}.")
    free = [
        stage.name
        for stage in graph.stages
        if not issubclass(stage.cls, Source) and not stage.cls.inline
        if not any(cost.stage == stage.name and _has_cpu(cost) for cost in found)
    ]
    if free:
        notes.append(
            f"Not known, so taken to cost no CPU: {', '.join(free)}. Measure it: "
            f"overflight profile {graph.file} --save-costs costs.yaml"
        )
    sources = {
        stage.name: _source(stage, table.sources.get(stage.name))
        for stage in graph.stages
        if issubclass(stage.cls, Source)
    }
    if any(source.phase_ms is None for source in sources.values()):
        notes.append(
            "Sensors without a fixed phase run free: over the plan they slip through all phases."
        )
    return Known(
        table.model_copy(update={"sources": sources, "costs": tuple(found)}),
        choices,
        tuple(notes),
    )


def _has_cpu(cost: StageCost) -> bool:
    return cost.process_ms is not None or cost.prepare_ms is not None


def _able(graph: Graph, catalog: Catalog, stage: GraphStage, model: str) -> list[str]:
    """The devices that can run a stage's model; those of its ladder first."""
    names = dict.fromkeys([*stage.ladder, *graph.devices])
    return [name for name in names if catalog.check(model, graph.devices[name].make()) is None]


def _on_each_device(
    graph: Graph, table: Costs, stage: GraphStage, model: str, able: Iterable[str]
) -> dict[str, StageCost]:
    """The stage's cost on those devices whose time is known."""
    measured = {name: cost for name in able if (cost := table.of(stage.name, name))}
    # The steps on the CPU are those of the stage, nearly the same whatever device is between them.
    like = next(iter(measured.values()), StageCost(stage=stage.name))
    found: dict[str, StageCost] = {}
    for name in able:
        if name in measured:
            found[name] = measured[name]
        elif (ms := _latency_ms(graph, name, model)) is not None:
            infer = {"device": name, "infer_ms": Spread(p50=ms, p99=ms)}
            found[name] = like.model_copy(update=infer)
    return found


def _latency_ms(graph: Graph, device: str, model: str) -> float | None:
    """What the file declares of an emulated device, or the shipped table of one of that name."""
    declared = getattr(graph.devices[device].make(), "latency_ms", {})
    if model in declared:
        return float(declared[model])
    try:
        return column(f"{SHIPPED}.{device}").get(model)
    except ValueError:
        return None


def _source(stage: GraphStage, measured: SourceCost | None) -> SourceCost:
    """What the table has, and what the source says of itself. Raises DataError."""
    source = stage.make()
    assert isinstance(source, Source)
    try:
        timing = source.timing()
    except (OverflightError, OSError, ValueError, LookupError):
        timing = None  # it would have to read data that is not here
    if measured is not None:
        own = {} if timing is None else {name: getattr(timing, name) for name in FIXED}
        known = {name: value for name in FIXED if (value := getattr(measured, name)) is not None}
        return measured.model_copy(update={**own, **known})
    if timing is None or timing.rate_hz <= 0:
        raise DataError(
            f"stages.{stage.name}: its rate is not known before it runs; write it into the file "
            f"for --costs: sources: {{{stage.name}: {{period_ms: 100, delay_ms: 0}}}}"
        )
    return SourceCost(
        period_ms=1e3 / timing.rate_hz,
        jitter_ms=timing.jitter_ms,
        delay_ms=timing.delay_ms,
        phase_ms=timing.phase_ms,
        extent_ms=timing.extent_ms,
    )
