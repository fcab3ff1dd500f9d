"""Random graphs and flights for the scheduler, as plain values that print as a reproducer.

A `Script` is a topology and everything that happens to it: arrivals, how long every step takes and
what it says, ends of sources, devices that come and go, what checks answer, a stop.
`virtual_time.drive` plays it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

from pipeline.scheduling.topology import (
    Input,
    Missing,
    OnError,
    Policy,
    Port,
    StageNode,
    Sync,
    Topology,
)


def examples(count: int) -> settings:
    """`count` fixed examples, or thousands of new ones with --hypothesis-profile=deep."""
    deep = settings().max_examples
    if deep < 1000:
        return settings(deadline=None, derandomize=True, max_examples=count, database=None)
    return settings(deadline=None, max_examples=deep)


@dataclass(frozen=True)
class Arrival:
    """A message that a source brings."""

    at: int
    port: Port
    stamp: int
    begin: int
    end: int


@dataclass(frozen=True)
class Behavior:
    """How a stage's runs go; each tuple is cycled by the run's number."""

    first: tuple[int, ...] = (1,)  #: duration of process, or of prepare
    infer: tuple[int, ...] = (1,)
    finish: tuple[int, ...] = (1,)
    says: tuple[str, ...] = ("all",)  #: each one of SAYINGS
    later: int = 1  #: how far "later" lies after the trigger's stamp


#: all ports, the first port, None, raise at the end, in the first step or in infer, an own later
#: stamp, a stamp below the trigger's, all ports after the infer lost the first rung, or every rung
SAYINGS = (
    *("all", "one", "none", "raise", "raise early", "raise infer", "later", "below"),
    *("lost", "lost", "lost", "lost all"),
)  # fmt: skip


@dataclass(frozen=True)
class Happening:
    at: int
    kind: str  #: "ended", "down", "up", "stop", "abandon" or "time"
    name: str = ""


@dataclass(frozen=True)
class Script:
    topology: Topology
    arrivals: tuple[Arrival, ...]
    behaviors: dict[str, Behavior]
    happenings: tuple[Happening, ...] = ()
    offline: bool = False
    steps_first: bool = True  #: of what happens at one instant, the ends of steps come first
    patient: bool = True  #: a source waits until it is ready
    checks: tuple[tuple[int, bool], ...] = ()  #: how long each takes and what it says; then yes

    def check(self, number: int) -> tuple[int, bool]:
        return self.checks[number] if number < len(self.checks) else (1, True)

    def __str__(self) -> str:
        lines = [f"offline={self.offline} workers={self.topology.workers}"]
        for node in self.topology.stages:
            lines.append(f"stage {node.name}: {_differences(node)}")
            lines += [f"    {entry.name}: {_differences(entry)}" for entry in node.inputs]
            lines += [f"    {_differences(self.behaviors[node.name])}"] if node.inputs else []
        lines.append(f"checks={self.checks} each {self.topology.check_every}")
        return "\n".join([*lines, *map(str, self.arrivals), *map(str, self.happenings)])

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """What hypothesis prints of a failing example; the mismatch tells the whole story."""
        printer.text("<the script above>")


def _differences(value: Any) -> str:
    """The fields that are not at their default, short."""
    shown = []
    for entry in fields(value):
        content = getattr(value, entry.name)
        if content != entry.default and entry.name not in ("name", "inputs"):
            text = ",".join(map(str, content)) if isinstance(content, tuple) else str(content)
            shown.append(f"{entry.name}={text}")
    return " ".join(shown)


def often(value: Any, other: st.SearchStrategy[Any], share: int = 3) -> st.SearchStrategy[Any]:
    """`value` in all but one of `share` + 1 draws."""
    drawn = st.tuples(st.integers(0, share), other)
    return drawn.map(lambda pair: pair[1] if pair[0] == share else value)


# Drawn in units and built once: making strategies costs more than drawing from them.
INSTANT = st.integers(0, 200)
SHORT = st.integers(0, 30)
LASTING = st.lists(st.integers(0, 25), min_size=1, max_size=3)
WAIT = st.one_of(SHORT, st.integers(40, 200))
SYNC = st.sampled_from([Sync.NEAREST, Sync.EXACT, Sync.LATEST, Sync.SPAN])
MISSING, POLICY, ON_ERROR = map(st.sampled_from, (Missing, Policy, OnError))
DECIMATED = often(None, st.integers(5, 25), share=5)
OFFSET = often(0, st.integers(-6, 6))
RARE_LIMIT = often(None, st.integers(0, 40))
RARELY = often(False, st.just(True))
OFTEN = often(True, st.just(False))
SELECT = often(None, st.just("frames"), share=1)
SIZE, MAX_IN_FLIGHT = st.integers(1, 3), st.sampled_from([1, 1, 2, 3])
PRIORITY = often(0, st.integers(-1, 1))
OUTPUTS = st.sampled_from([("out",), ("out",), ("out", "aux"), ()])
SOURCE_OUTPUTS = often(("out",), st.just(("out", "aux")))
PROMISE = often(None, st.integers(2, 12))
PERIOD = st.integers(3, 20)
#: jitter of the stamp, arrival delay, extent before and after the stamp
STEPS = st.lists(
    st.tuples(
        often(0, st.integers(-22, 3)),
        st.integers(0, 25),
        often((0, 0), st.tuples(st.integers(0, 5), st.integers(0, 5))),
    ),
    min_size=3,
    max_size=14,
)
#: of an even stream: mostly no jitter, a few times a frame is lost
EVEN_STEPS = st.lists(
    st.tuples(often(0, st.sampled_from([-1, 1, 30]), share=8), st.integers(0, 4), st.just((0, 0))),
    min_size=12,
    max_size=24,
)
SAYS = st.lists(often("all", st.sampled_from(SAYINGS)), min_size=1, max_size=4).map(tuple)
TIMEOUT = often(None, st.integers(1, 30), share=2)
CHECKS = st.lists(st.tuples(st.integers(0, 40), st.booleans()), max_size=8).map(tuple)
CHECK_EVERY = st.integers(1, 40)


def scaled(value: int | None, unit: int) -> int | None:
    return None if value is None else value * unit


@st.composite
def inputs(draw: st.DrawFn, name: str, ports: list[Port], unit: int) -> Input:
    """A sync input."""
    count = 2 if len(ports) > 1 and draw(RARELY) else 1
    sources = draw(st.permutations(ports))[:count]
    sync = draw(SYNC)
    measured = sync is Sync.EXACT and draw(st.booleans())
    return Input(
        name,
        tuple(sources),
        sync,
        many=count > 1,
        tolerance=draw(SHORT) * unit if sync is Sync.NEAREST else 0,
        offset=draw(OFFSET) * unit,
        max_wait=None if measured else draw(WAIT) * unit,
        missing=draw(MISSING),
        hold=draw(SHORT) * unit,
        period=scaled(draw(DECIMATED), unit),
    )


@st.composite
def triggers(draw: st.DrawFn, ports: list[Port], unit: int, even: bool) -> Input:
    select = draw(SELECT)
    policy = Policy.LATEST if select or (even and draw(OFTEN)) else draw(POLICY)
    return Input(
        "trigger",
        (draw(st.sampled_from(ports)),),
        policy=policy,
        size=1 if policy is Policy.LATEST else draw(SIZE),
        max_age=scaled(draw(RARE_LIMIT), unit),
        select=select,
        period=scaled(draw(DECIMATED), unit),
    )


@st.composite
def stages(
    draw: st.DrawFn, name: str, ports: list[Port], devices: tuple[str, ...], unit: int, even: bool
) -> StageNode:
    rules = [draw(inputs(f"sync{n}", ports, unit)) for n in range(draw(st.integers(0, 2)))]
    trigger = draw(triggers(ports, unit, even))
    rules.insert(draw(st.integers(0, len(rules))), trigger)
    ladder = draw(st.permutations(devices))[
        : draw(st.integers(min(int(even), len(devices)), len(devices)))
    ]
    outputs = draw(OUTPUTS)
    wanted = trigger.policy is Policy.LATEST and draw(OFTEN if even else RARELY)
    return StageNode(
        name,
        tuple(rules),
        outputs=("out",) if even and wanted else outputs,
        devices=tuple(ladder),
        max_in_flight=draw(MAX_IN_FLIGHT),
        priority=draw(PRIORITY),
        inline=not ladder and draw(RARELY),
        stateless=draw(RARELY),
        on_error=draw(ON_ERROR),
        wanted=wanted,
        timeout=scaled(draw(TIMEOUT), unit) if ladder else None,
        degraded_period=scaled(draw(DECIMATED), unit) if ladder else None,
    )


def alike(nodes: list[StageNode]) -> list[StageNode]:
    """All members of a select group are `wanted` as its first is."""
    group: dict[tuple[Port, str], bool] = {}
    made = []
    for node in nodes:
        if node.inputs and node.trigger.select:
            key = node.trigger.sources[0], node.trigger.select
            node = replace(node, wanted=group.setdefault(key, node.wanted))
        made.append(node)
    return made


@st.composite
def fusions(draw: st.DrawFn, name: str, nodes: list[StageNode], unit: int) -> StageNode:
    """What wishes are made of: triggered by a sensor, it chooses from stages that are `wanted`."""
    sensors = [Port(node.name) for node in nodes if node.is_source]
    chosen = [Port(node.name) for node in nodes if node.wanted and node.outputs]
    rules = [Input("trigger", (draw(st.sampled_from(sensors)),), policy=Policy.DROP_OLDEST, size=9)]
    for n, port in enumerate(draw(st.permutations(chosen))[:2]):
        rule = draw(inputs(f"sync{n}", [port], unit))
        if draw(st.booleans()):
            wait = rule.max_wait or 50 * unit
            rule = replace(rule, sync=Sync.NEAREST, tolerance=25 * unit, max_wait=wait)
        rules.append(rule)
    return StageNode(name, tuple(rules), outputs=())


@st.composite
def topologies(draw: st.DrawFn, unit: int, even: bool = False) -> Topology:
    nodes: list[StageNode] = []
    for n in range(draw(st.integers(1 + even, 3))):
        promise = scaled(draw(PROMISE), unit)
        nodes.append(StageNode(f"source{n}", outputs=draw(SOURCE_OUTPUTS), min_period=promise))
    devices = ("npu", "gpu", "cpu")[: draw(st.integers(int(even), 3))]
    for n in range(draw(st.integers(1, 6))):
        ports = [Port(node.name, name) for node in nodes for name in node.outputs]
        nodes.append(draw(stages(f"stage{n}", ports, devices, unit, even)))
    nodes = alike(nodes)
    if even and any(node.wanted for node in nodes):
        nodes += [draw(fusions(f"fusion{n}", nodes, unit)) for n in range(draw(SIZE))]
    check_every = draw(CHECK_EVERY) * unit
    return Topology(tuple(nodes), draw(st.integers(1, 3)), check_every)


@st.composite
def arrivals(draw: st.DrawFn, port: Port, unit: int, even: bool) -> list[Arrival]:
    """One port's messages: mostly regular, late by a varying delay, now and then backward; or an
    even stream."""
    period, stamp, at = draw(PERIOD), draw(PERIOD), 0
    made: list[Arrival] = []
    for jitter, delay, (before, after) in draw(EVEN_STEPS if even else STEPS):
        at = max(at, stamp + delay)
        extent = (stamp - before) * unit, (stamp + after) * unit
        made.append(Arrival(at * unit, port, stamp * unit, *extent))
        stamp += period + jitter
    return made


@st.composite
def behaviors(draw: st.DrawFn, unit: int) -> Behavior:
    first, infer, finish = (tuple(n * unit for n in draw(LASTING)) for _ in range(3))
    return Behavior(first, infer, finish, draw(SAYS), (draw(SHORT) + 1) * unit)


@st.composite
def happenings(draw: st.DrawFn, topology: Topology, unit: int) -> list[Happening]:
    sources = [node.name for node in topology.stages if node.is_source]
    devices = sorted({device for node in topology.stages for device in node.devices})
    what = [("time", ""), ("time", ""), *(("ended", source) for source in sources)]
    what += [(change, device) for change in ("down", "up") for device in devices] * 2
    drawn = draw(st.lists(st.tuples(INSTANT, st.sampled_from(what)), max_size=5))
    made = [Happening(at * unit, *which) for at, which in drawn]
    stop = draw(often(None, INSTANT))
    if stop is not None:
        made.append(Happening(stop * unit, "stop"))
        if draw(st.booleans()):
            made.append(Happening((stop + draw(SHORT)) * unit, "abandon"))
    return made


@st.composite
def scripts(draw: st.DrawFn, offline: bool | None = None) -> Script:
    """Any flight of any graph. A unit of 0.1 s brings the rules' fixed seconds into reach."""
    unit = draw(st.sampled_from([1, 1, 100_000_000]))
    offline = draw(RARELY) if offline is None else offline
    even = draw(st.booleans())
    topology = draw(topologies(unit, even))
    ports = [
        Port(node.name, name) for node in topology.stages if node.is_source for name in node.outputs
    ]
    return Script(
        topology,
        tuple(
            sorted((a for p in ports for a in draw(arrivals(p, unit, even))), key=lambda a: a.at)
        ),
        {node.name: draw(behaviors(unit)) for node in topology.stages if not node.is_source},
        () if offline else tuple(sorted(draw(happenings(topology, unit)), key=lambda h: h.at)),
        offline,
        draw(st.booleans()),
        draw(st.booleans()),
        tuple((lasts * unit, works) for lasts, works in draw(CHECKS)),
    )
