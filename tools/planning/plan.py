"""`overflight plan`: predicts every assignment of stages to devices in virtual time, and ranks
them."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice, product
from pathlib import Path

import typer
from rich.console import Console

from pipeline.drivers.plan import run_plan
from pipeline.graph.graph import Graph
from pipeline.graph.spec import ExpectSpec, OutputExpectation
from pipeline.graph.wording import suggest
from pipeline.measuring.costs import Costs, read_costs
from pipeline.measuring.expectations import verdicts
from tools.drawing.gantt import gantt
from tools.drawing.picture import write_picture
from tools.load import open_graph
from tools.planning.plan_costs import Known, gather
from tools.planning.plan_ranking import Option, Ranking, assignment, ranked
from tools.planning.plan_report import plan_json, print_plan
from tools.watching.progress import end_ports

#: More assignments than this are not even looked at.
MOST = 100_000
#: The part of the virtual run that the picture shows: after every stream has found its place.
SHOWN_S = (2.0, 2.4)


def plan_file(
    path: Path,
    *,
    settings: Sequence[str] = (),
    overlays: Sequence[Path] = (),
    models: Sequence[Path] = (),
    costs: Path | None = None,
    seconds: float = 30.0,
    limit_s: float = 60.0,
    cores: int | None = None,
    max_cpu: float | None = None,
    min_rates: Sequence[str] = (),
    seed: int = 0,
    top: int = 10,
    picture: Path | None = None,
    as_json: bool = False,
) -> bool:
    """Plan and print; True where the best assignment meets every demand.

    Raises GraphError, DataError, typer.BadParameter.
    """
    graph, catalog = open_graph(path, settings, overlays, models)
    expect = demands(graph, max_cpu, min_rates)
    table = None if costs is None else read_costs(costs)
    known = gather(graph, catalog, table, cores or len(os.sched_getaffinity(0)))
    cores = cores or known.costs.machine.cores
    record_s = SHOWN_S if seconds > SHOWN_S[1] else (0.0, seconds)

    def tried(devices: Mapping[str, str]) -> Option:
        plan = run_plan(
            assigned(graph, devices),
            known.costs,
            seconds=seconds,
            cores=cores,
            seed=seed,
            record_s=record_s,
        )
        is_files = all(graph.stage(name).ladder[0] == device for name, device in devices.items())
        return Option(devices, is_files, plan, tuple(verdicts(expect, plan.report)))

    options = try_all(known, tried, limit_s)
    ends = end_ports(graph.topology)
    count = math.prod(len(names) for names in known.choices.values())
    ranking = Ranking(graph, ends, known, ranked(options, ends), count, seconds, cores)
    if picture is not None:
        best = ranking.options[0]
        title = f"{graph.name}, predicted: " + (assignment(best.devices) or "no choice of devices")
        write_picture(gantt(best.plan.bars, graph.topology, record_s, title), picture)
    if as_json:
        typer.echo(plan_json(ranking))
    else:
        print_plan(ranking, Console(), top=top, picture=picture)
    return not ranking.options[0].failed


def demands(graph: Graph, max_cpu: float | None, min_rates: Sequence[str]) -> ExpectSpec:
    """What the file expects, with what the command line says over it."""
    outputs = dict(graph.expect.outputs)
    ports = [f"{node.name}/{port}" for node in graph.topology.stages for port in node.outputs]
    for words in min_rates:
        name, _, hz = words.partition("=")
        try:
            rate = float(hz)
        except ValueError:
            rate = 0.0
        if not 0 < rate < math.inf:
            raise typer.BadParameter(f"--min-rate {words}: write OUTPUT=HZ, with a rate above 0")
        port = name if "/" in name else f"{name}/out"
        if port not in ports:
            known = [each.removesuffix("/out") for each in ports]
            raise typer.BadParameter(
                f"--min-rate {words}: no output '{name}'{suggest(name, known)}"
            )
        rule = outputs.get(port, OutputExpectation.model_construct())
        outputs[port] = rule.model_copy(update={"min_rate_hz": rate})
    cpu = graph.expect.max_cpu_cores if max_cpu is None else max_cpu
    return graph.expect.model_copy(update={"outputs": outputs, "max_cpu_cores": cpu})


def assigned(graph: Graph, devices: Mapping[str, str]) -> Graph:
    """The same graph with each of these stages on one device alone."""
    nodes = tuple(
        replace(node, devices=(devices[node.name],)) if node.name in devices else node
        for node in graph.topology.stages
    )
    return replace(graph, topology=replace(graph.topology, stages=nodes))


def assignments(known: Known) -> list[dict[str, str]]:
    """The file's own first, then those with the least to do on their busiest device."""
    stages = list(known.choices)
    found = [
        dict(zip(stages, devices, strict=True))
        for devices in islice(product(*known.choices.values()), MOST)
    ]
    return found[:1] + sorted(found[1:], key=lambda devices: _busiest_ms(devices, known.costs))


def _busiest_ms(devices: Mapping[str, str], costs: Costs) -> float:
    """How long the busiest device takes to serve each of its stages once."""
    turns: dict[str, float] = {}
    for stage, device in devices.items():
        cost = costs.of(stage, device)
        if cost is not None and cost.infer_ms is not None:
            turns[device] = turns.get(device, 0.0) + cost.infer_ms.p50
    return max(turns.values(), default=0.0)


def try_all(
    known: Known,
    tried: Callable[[Mapping[str, str]], Option],
    limit_s: float,
) -> list[Option]:
    """Every assignment that the time allows, at least one; Ctrl-C ends it with what is there."""
    todo = assignments(known)
    options: list[Option] = []
    end = time.monotonic() + limit_s
    longest = 0.0
    with Console(stderr=True).status(f"planning 1 of {len(todo)} assignments ...") as status:
        for number, devices in enumerate(todo, 1):
            started = time.monotonic()
            if options and started + longest > end:
                break
            status.update(f"planning {number} of {len(todo)} assignments ...")
            try:
                options.append(tried(devices))
            except KeyboardInterrupt:
                if not options:
                    raise
                break
            longest = max(longest, time.monotonic() - started)
    return options
