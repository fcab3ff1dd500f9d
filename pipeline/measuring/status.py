"""How a running graph stands: the page that `overflight top` shows, put up about twice a second.

It is made while the scheduler stands still, which takes some tenths of a millisecond. Rates and
shares are those of the last seconds, from what was counted before.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeAlias

from pipeline.clock import Clock
from pipeline.measuring.statistics import PortStatistics, Statistics
from pipeline.scheduling.events import Reason
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port, StageNode, Topology

#: Raised when a key of the page changes its meaning.
FORMAT = 1
PERIOD_NS = 500_000_000
#: Pages that rates and shares look back on: five seconds.
WINDOW = 10
EVENTS_SHOWN = 20
#: Reasons that a person watching a run counts as a loss.
LOSSES = frozenset(Reason) - {Reason.PASSED_OVER, Reason.DECIMATED, Reason.NOT_WANTED}

#: What only grows, by (what, of whom): counts, and times in ns.
Counters: TypeAlias = Mapping[tuple[str, str], int]


class Pages(Protocol):
    """Where pages are put up: a `Board`, or the end of a supervisor's line."""

    def write(self, page: Mapping[str, Any]) -> None: ...


class Status:
    """Puts up the pages of one run. Used from one thread."""

    def __init__(
        self,
        board: Pages,
        graph: str,
        topology: Topology,
        scheduler: Scheduler,
        statistics: Statistics,
    ) -> None:
        self._board = board
        self._nodes = topology.stages
        self._scheduler = scheduler
        self._statistics = statistics
        self._ports = {
            str(port): port
            for node in topology.stages
            for port in (Port(node.name, out) for out in node.outputs)
        }
        self._past: deque[Counters] = deque(maxlen=WINDOW)
        self._due_ns = 0
        self._head: dict[str, Any] = {
            "format": FORMAT,
            "graph": graph,
            "pid": os.getpid(),
            "began": time.time(),
        }
        board.write(self._head | {"state": "opening"})

    def begin(
        self, speed: float | None, clock: Clock, still: Callable[[], AbstractContextManager[object]]
    ) -> None:
        """The graph runs from now on; `still` is the driver's."""
        self._head["speed"] = "max" if speed is None else speed
        self._clock = clock
        self._still = still
        self._began_ns = time.monotonic_ns()
        self._past.append(self._counters(self._scheduler.books.ledger()))

    def tick(self) -> None:
        """Put up a page if one is due; cheap where none is."""
        if time.monotonic_ns() < self._due_ns:
            return
        with self._still():
            page = self._page()
        with contextlib.suppress(OSError):  # a full disk is no reason to end a flight
            self._board.write(page)
        self._due_ns = time.monotonic_ns() + PERIOD_NS

    def _page(self) -> dict[str, Any]:
        ledger = self._scheduler.books.ledger()
        counters, before = self._counters(ledger), self._past[0]
        self._past.append(counters)
        now_ns = counters["now", ""]
        wall_ns = max(now_ns - before["now", ""], 1)

        def gained(what: str, name: str) -> int:
            return counters.get((what, name), 0) - before.get((what, name), 0)

        def per_s(what: str, name: str) -> float:
            return round(gained(what, name) * 1e9 / wall_ns, 2)

        def share(what: str, name: str) -> float:
            return round(gained(what, name) / wall_ns, 4)

        books = self._scheduler.books
        runs, held, inputs = books.runs(), books.statistics(), books.marks()
        return self._head | {
            "state": "running",
            "elapsed_s": round((now_ns - self._began_ns) / 1e9, 3),
            "cpu_cores": share("cpu", ""),
            "outputs": {
                name: self._output(name, before, per_s("messages", name)) for name in self._ports
            },
            "stages": {
                node.name: {
                    "runs": counters["runs", node.name],
                    "runs_hz": per_s("runs", node.name),
                    "cpu_cores": share("stage_cpu", node.name),
                    "lost": counters["lost", node.name],
                    "lost_hz": per_s("lost", node.name),
                    "running": runs.get(node.name, {}).get("running", 0),
                    "errors": self._statistics.stage(node.name).errors,
                    "stopped": self._scheduler.stopped(node.name),
                    **held.get(node.name, {}),
                    **({"inputs": inputs[node.name]} if node.name in inputs else {}),
                }
                for node in self._nodes
            },
            "edges": ledger,
            "devices": {
                name: {
                    "up": device.up,
                    "runs": sum(usage.runs for usage in device.usage.values()),
                    "busy_fraction": share("busy", name),
                    "inferring": device.inferring.stage if device.inferring else None,
                    "stages": [s.node.name for s in device.stages if s.device is device],
                }
                for name, device in self._scheduler.devices().items()
            },
            "failures": list(self._statistics.failures),
            "events": [event.page() for event in self._statistics.events[-EVENTS_SHOWN:]],
        }

    def _counters(self, ledger: Mapping[str, Mapping[str, Any]]) -> Counters:
        counters = {("now", ""): time.monotonic_ns(), ("cpu", ""): time.process_time_ns()}
        for name, port in self._ports.items():
            known = self._statistics.ports.get(port) or PortStatistics()
            counters["messages", name] = known.count
            counters["last", name] = known.last_ns
        runs = self._scheduler.books.runs()
        for node in self._nodes:
            book = runs.get(node.name)
            counters["runs", node.name] = book["started"] if book else _most(node, counters)
            counters["lost", node.name] = 0
        for edge, page in ledger.items():
            target = edge.split("->")[1].split("/")[0]
            lost = (count for reason, count in page["dropped"].items() if reason in LOSSES)
            counters["lost", target] += sum(lost)
        for stage, measured in self._statistics.stages.items():
            counters["stage_cpu", stage] = sum(measured.cpu_ns.values())
        for name, device in self._scheduler.devices().items():
            counters["busy", name] = sum(usage.busy_ns for usage in device.usage.values())
        return counters

    def _output(self, name: str, before: Counters, per_s: float) -> dict[str, Any]:
        """One output: its rate, and how old every sensor's sample was when it was published."""
        known = self._statistics.ports.get(self._ports[name])
        if known is None:
            return {"count": 0, "rate_hz": 0.0, "silent_s": None, "ages_ms": {}}
        page: dict[str, Any] = {"count": known.count}
        if self._statistics.offline:  # the graph's clock leaps: a second is a real one
            return page | {"rate_hz": per_s, "silent_s": None, "ages_ms": {}}
        # Between two messages, not two pages: a slow stream has few in the window.
        count, last_ns = before["messages", name], before["last", name]
        if not count:
            count, last_ns = 1, known.first_ns
        span_ns = known.last_ns - last_ns
        oldest: dict[str, int] = {}
        for sample in known.lineage:
            oldest[sample.stream] = min(sample.stamp, oldest.get(sample.stream, sample.stamp))
        ages = {stream: (known.last_ns - stamp) / 1e6 for stream, stamp in oldest.items()}
        return page | {
            "rate_hz": round((known.count - count) * 1e9 / span_ns, 2) if span_ns > 0 else 0.0,
            "silent_s": round(max(self._clock.now() - known.last_ns, 0) / 1e9, 3),
            "ages_ms": {stream: round(age, 1) for stream, age in ages.items()},
        }


def _most(node: StageNode, counters: Counters) -> int:
    """What a source brought on its busiest output: it has no runs."""
    return max((counters["messages", f"{node.name}/{out}"] for out in node.outputs), default=0)
