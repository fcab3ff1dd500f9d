"""Checks the inputs of a stage against its contract and makes the scheduler's inputs of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from pipeline.graph.contract import Contract, InputPort, OutputPort, fits, type_name
from pipeline.graph.nodes import Steps
from pipeline.graph.report import Report
from pipeline.graph.spec import InputSpec, QueueSpec, StageSpec
from pipeline.graph.wording import listed, suggest
from pipeline.scheduling.topology import Input, Missing, Policy, Port, Sync

#: How long a nearest or span input may keep a set waiting unless the file says otherwise: two
#: periods of a 10 Hz sensor, so that one late message costs nothing and a dead sensor little.
DEFAULT_MAX_WAIT_MS = 200.0

#: Which keys go with which sync, beside `from`, `sync` and `rate_hz`.
_KEYS: dict[Sync, frozenset[str]] = {
    Sync.TRIGGER: frozenset({"select", "max_age_ms", "queue"}),
    Sync.EXACT: frozenset({"offset_ms", "max_wait_ms", "missing", "hold_ms"}),
    Sync.NEAREST: frozenset({"tolerance_ms", "offset_ms", "max_wait_ms", "missing", "hold_ms"}),
    Sync.LATEST: frozenset({"offset_ms", "missing"}),
    Sync.SPAN: frozenset({"offset_ms", "max_wait_ms", "missing"}),
}
_RULES = frozenset().union(*_KEYS.values())
_WHY_NOT = {
    ("max_wait_ms", Sync.LATEST): "'latest' takes what is there and never waits; remove it",
    ("hold_ms", Sync.LATEST): "'latest' takes the last message however old; remove it",
    ("hold_ms", Sync.SPAN): "a span is many messages, of which none is held; remove it",
}


@dataclass(frozen=True, slots=True)
class Wirer:
    """What the inputs of every stage are checked against."""

    contracts: Mapping[str, Contract | None]  #: by stage; None where its class is wrong
    damaged: Collection[Steps]  #: specs that lost an entry
    report: Report

    def inputs(self, name: str, spec: StageSpec, contract: Contract) -> tuple[Input, ...]:
        """The inputs of a stage in the order of its signature; mistakes are reported."""
        steps: Steps = ("stages", name, "inputs")
        if contract.is_source:
            if spec.inputs:
                self.report.mistake(steps, "a source takes no inputs", at_key=True)
            return ()
        if steps[:-1] in self.damaged and self.report.has(steps) and not spec.inputs:
            return ()  # the block was no mapping
        ports = [port.name for port in contract.inputs]
        meant: set[str] = set()  # ports whose edge is there, but wrong
        for given, unknown in spec.inputs.items():
            if given in ports:
                continue
            way_out = suggest(given, [port for port in ports if port not in spec.inputs])
            what = f"{spec.use} has no input '{given}'{way_out}"
            self.report.mistake((*steps, given), what, at_key=True)
            meant |= {port for port in ports if f"mean '{port}'" in way_out}
            for number, text in enumerate(unknown.source):
                self._output(text, (*steps, given, "from", number))
        meant |= {port for port in ports if (*steps, port) in self.damaged}
        wired = []
        complete = True
        for port in contract.inputs:
            if port.name in spec.inputs:
                wired.append(self._input(port, spec.inputs[port.name], (*steps, port.name)))
            elif not port.has_default and port.name not in meant:
                complete = False
                what = f"misses an edge to the input '{port.name}', which has no default"
                self.report.mistake(steps, what)
        if complete:
            self._check_triggers(steps, spec, wired)
        return tuple(wired)

    def _check_triggers(self, steps: Steps, spec: StageSpec, wired: list[Input]) -> None:
        broken = any((*steps, port) in self.damaged for port in self.report.entries(steps))
        if broken or len(wired) < len(spec.inputs):
            return  # what is missing may be the trigger
        triggers = [f"'{entry.name}'" for entry in wired if entry.sync is Sync.TRIGGER]
        if len(triggers) > 1:
            what = (
                f"has {len(triggers)} triggers, {listed(triggers, 'and')}; one input starts the "
                "runs, and 'sync' says of every other one how it joins them"
            )
            self.report.mistake(steps, what)
        elif wired and not triggers:
            what = "has no trigger; remove 'sync' from the input whose messages start the runs"
            self.report.mistake(steps, what)
        elif not wired:
            self.report.mistake(steps[:-1], "no source reaches it: none of its inputs has an edge")

    def _input(self, port: InputPort, spec: InputSpec, steps: Steps) -> Input:
        self._check_port(port, spec, steps)
        if steps not in self.damaged:
            self._check_rules(port, spec, steps)
        trigger = spec.sync is Sync.TRIGGER
        waits = spec.sync in (Sync.NEAREST, Sync.SPAN)
        max_wait_ms = (
            DEFAULT_MAX_WAIT_MS if waits and spec.max_wait_ms is None else spec.max_wait_ms
        )
        missing = Missing.PROCEED if port.optional and not trigger else Missing.SKIP
        return Input(
            name=port.name,
            sources=self._edges(port, spec, steps),
            sync=spec.sync,
            many=port.many,
            tolerance=_ns(spec.tolerance_ms) or 0,
            offset=_ns(spec.offset_ms) or 0,
            max_wait=_ns(max_wait_ms),
            missing=spec.missing or missing,
            hold=_ns(spec.hold_ms) or 0,
            policy=spec.queue.policy if spec.queue else Policy.LATEST,
            size=spec.queue.size if spec.queue else 1,
            max_age=_ns(spec.max_age_ms),
            select=spec.select,
            compress=spec.compress,
            period=None if spec.rate_hz is None else round(1e9 / spec.rate_hz),
        )

    def _check_port(self, port: InputPort, spec: InputSpec, steps: Steps) -> None:
        """Whether the port can be fed like this at all."""
        if len(spec.source) > 1 and not port.many:
            what = (
                f"'{port.name}' takes one edge, got {len(spec.source)}; a port that takes several "
                "is annotated tuple[Message[T] | None, ...]"
            )
            self.report.mistake((*steps, "from"), what)
        if steps in self.damaged:
            return
        if port.many and spec.sync is Sync.TRIGGER:
            what = (
                f"'{port.name}' takes several edges, so it cannot be the trigger; say sync: exact, "
                "nearest or latest"
            )
            self.report.mistake(steps, what)
        if port.span and spec.sync is not Sync.SPAN:
            what = f"'{port.name}' is a Span and takes sync: span, not {spec.sync}"
            self.report.mistake((*steps, "sync"), what)
        if spec.sync is Sync.SPAN and not port.span:
            what = f"'{port.name}' takes one message; sync: span is for an input annotated Span[T]"
            self.report.mistake((*steps, "sync"), what)

    def _check_rules(self, port: InputPort, spec: InputSpec, steps: Steps) -> None:
        """Whether the keys go together."""
        allowed = _KEYS[spec.sync]
        for key in sorted(_RULES - allowed):
            if getattr(spec, key) is not None:
                homes = listed([sync.value for sync, keys in _KEYS.items() if key in keys], "or")
                this = "the trigger" if spec.sync is Sync.TRIGGER else f"sync: {spec.sync}"
                why = _WHY_NOT.get((key, spec.sync), f"it goes with sync: {homes}, this is {this}")
                what = f"'{key}' has no effect here: {why}"
                self.report.mistake((*steps, key), what, at_key=True)
        if spec.sync is Sync.NEAREST and spec.tolerance_ms is None:
            what = "sync: nearest needs 'tolerance_ms': how far from the trigger is near enough"
            self.report.mistake(steps, what)
        if spec.sync is Sync.TRIGGER and spec.queue is not None:
            self._check_queue(spec, spec.queue, steps)
        if "missing" in allowed:
            self._check_missing(port, spec, steps)

    def _check_queue(self, spec: InputSpec, queue: QueueSpec, steps: Steps) -> None:
        if queue.policy is Policy.LATEST and queue.size > 1:
            what = "policy latest keeps one message; for more say drop_oldest, drop_newest or block"
            self.report.mistake((*steps, "queue", "size"), what)
        if queue.policy is not Policy.LATEST and spec.select is not None:
            what = f"inputs with 'select' have the queue latest, not {queue.policy}"
            self.report.mistake((*steps, "queue"), what)

    def _check_missing(self, port: InputPort, spec: InputSpec, steps: Steps) -> None:
        place = (*steps, "missing")
        holds = spec.missing is Missing.HOLD
        if holds and "hold_ms" not in _KEYS[spec.sync]:
            what = f"hold does not go with sync: {spec.sync}; say proceed or skip"
            self.report.mistake(place, what)
            return
        if holds and spec.hold_ms is None:
            self.report.mistake(place, "hold needs 'hold_ms': how old the held message may be")
        if spec.hold_ms is not None and not holds and "hold_ms" in _KEYS[spec.sync]:
            self.report.mistake((*steps, "hold_ms"), "'hold_ms' needs 'missing: hold'", at_key=True)
        if spec.missing in (Missing.PROCEED, Missing.HOLD) and not port.optional:
            wanted = "Span[T] | None" if port.span else "Message[T] | None"
            what = (
                f"{spec.missing} may give None, which '{port.name}' does not take; say skip, or "
                f"annotate it {wanted}"
            )
            self.report.mistake(place, what)

    def _edges(self, port: InputPort, spec: InputSpec, steps: Steps) -> tuple[Port, ...]:
        edges: list[Port] = []
        for number, text in enumerate(spec.source):
            place = (*steps, "from", number)
            found = self._output(text, place)
            if found is None:
                continue
            edge, output = found
            if not fits(output.payload, port.payload):
                what = f"'{port.name}' takes {_names(port.payload)}, and '{text}' gives "
                self.report.mistake(place, what + _names(output.payload))
            if edge in edges:
                self.report.mistake(place, f"'{text}' is in this list twice")
            edges.append(edge)
        return tuple(edges)

    def _output(self, text: str, steps: Steps) -> tuple[Port, OutputPort] | None:
        stage, slash, name = text.partition("/")
        if stage not in self.contracts:
            self.report.mistake(steps, f"no stage '{stage}'{suggest(stage, self.contracts)}")
            return None
        contract = self.contracts[stage]
        if contract is None:
            return None
        output = contract.output(name if slash else "out")
        if output is not None:
            return Port(stage, output.name), output
        ports = [port.name for port in contract.outputs]
        if not ports:
            what = f"'{stage}' is a sink: it has no output"
        elif slash:
            what = f"'{stage}' has no output '{name}'{suggest(name, ports)}"
        else:
            choices = [f"{stage}/{port}" for port in ports]
            what = f"'{stage}' has more than one output; say which: {listed(choices, 'or')}"
        self.report.mistake(steps, what)
        return None


def _ns(ms: float | None) -> int | None:
    return None if ms is None else round(ms * 1e6)


def _names(kinds: tuple[object, ...]) -> str:
    return listed([type_name(kind) for kind in kinds], "or")
