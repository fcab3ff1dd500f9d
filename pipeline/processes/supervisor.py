"""Starts the processes of a graph, keeps them alive by the rules of the file, ends them together.

It runs no stage and opens no device: a kill of any process leaves it, and it leaves the others.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from pipeline.drivers.run import RunResult
from pipeline.drivers.snapshot import Snapshot
from pipeline.errors import DeviceError, OverflightError
from pipeline.graph.graph import Graph
from pipeline.graph.run_folder import folder_of_this_run
from pipeline.measuring.ending import Ended, stopped_by_signals
from pipeline.measuring.statistics import Event
from pipeline.measuring.status import Pages
from pipeline.measuring.trace import Trace
from pipeline.processes.control import State
from pipeline.processes.endpoints import ends_of, host_of_clock
from pipeline.processes.fault_plan import planned_faults
from pipeline.processes.merging import merged_page, merged_report, snapshot_of
from pipeline.processes.process import PartProcess
from pipeline.transport import shared_files
from pipeline.transport.zenoh import Reserved

#: Between two looks at the processes, and between two pages of their status.
POLL_S, PAGE_S = 0.05, 0.5
#: How long the processes may take to find each other before the graph begins all the same.
MEETING_S = 10.0
#: How long a host waits for the one whose clock it follows before it says so.
PATIENCE_S = 2.0
#: From the word to go until the graph's clock starts: all must have heard it.
HEAD_START_NS = 300_000_000
#: So long after a process ended the others are told, whom the end of its streams may not reach: a
#: link may be cut.
FAREWELL_S = 2.0
#: How long an ending process may take for its last runs, its files and its report.
ENDING_S = 30.0


class Supervisor:
    """Runs a graph of several processes once.

    `module` is what each process runs (``python -m``), `opening` what it needs to load the graph.
    """

    def __init__(
        self,
        graph: Graph,
        module: str,
        opening: Mapping[str, Any],
        *,
        speed: float = 1.0,
        host: str | None = None,
        board: Pages | None = None,
        progress: Callable[[Snapshot], None] | None = None,
        trace: Trace | None = None,
    ) -> None:
        """`trace` gets the events of the supervisor itself."""
        self._graph = graph
        self._speed = speed
        self._board = board
        self._progress = progress
        self._trace = trace
        self._events: list[Event] = []
        self._stop_asked: signal.Signals | None = None
        self._origin = 0
        self._began_ns = 0  #: 0: not yet
        self._page_due = 0.0
        clock_host = host_of_clock(graph)
        self._follows = host not in (None, clock_host)  #: another host's clock
        run = f"{re.sub('[^A-Za-z0-9_-]', '-', graph.name)}-{os.getpid()}"
        if host is not None:  # both hosts must name the streams alike
            run = re.sub("[^A-Za-z0-9_-]", "-", graph.name)
        names = graph.placement.processes(host)
        self._reserved = ExitStack()
        endpoints = {name: self._reserved.enter_context(Reserved()).endpoint for name in names}
        self._processes = {
            name: PartProcess(
                graph.processes[name],
                module,
                {
                    **opening,
                    "call": "open",
                    "path": sys.path,
                    "process": name,
                    "run": run,
                    "speed": speed,
                    "affinity": graph.processes[name].affinity,
                    "nice": graph.processes[name].nice,
                    **ends_of(graph, name, names, endpoints),
                },
            )
            for name in names
        }
        self._faults = planned_faults(graph.faults, graph.placement, names)

    def run(self, duration_s: float | None) -> RunResult:
        """Run to the end of all parts, for `duration_s`, or to Ctrl-C.

        Raises OverflightError where a part does not open.
        """
        with self._reserved, folder_of_this_run(self._graph), self._all_closed():
            shared_files.sweep()
            for process in self._processes.values():
                process.start()
            self._open()  # Ctrl-C ends it at once: nothing has begun
            with stopped_by_signals(self._on_signal):
                ended = self._serve(duration_s)
                self._end()
            wall_ns = time.monotonic_ns() - self._began_ns
        how = f"signal {self._stop_asked.name}" if self._stop_asked else str(ended)
        report = merged_report(
            self._graph, list(self._processes.values()), self._events, wall_ns, how
        )
        return RunResult(report, tuple(report["failures"]), tuple(self._events), how)

    # ------------------------------------------------------------------ opening

    def _open(self) -> None:
        """Until all parts are open and have found each other; then give the word."""
        ready_since: float | None = None
        while True:
            for process in self._processes.values():
                if (how := self._look(process)) is not None:
                    raise DeviceError(f"processes.{process.name}: {how} while it opened")
                if process.state is State.FAILED and process.text:
                    raise OverflightError(process.text)
            now = time.monotonic()
            if all(process.state is State.READY for process in self._processes.values()):
                ready_since = ready_since or now
                missing = sorted({port for p in self._processes.values() for port in p.missing})
                if (not missing or now - ready_since > MEETING_S) and self._set_clock():
                    if missing:
                        self._event("not_heard", ", ".join(missing), "its process is not there yet")
                    break
                if self._follows and not self._events and now - ready_since > PATIENCE_S:
                    text = "all is open here; the graph's clock is that host's: start it there, too"
                    self._event("waiting", f"host {host_of_clock(self._graph)}", text)
                    self._show()
            time.sleep(POLL_S)
        for process in self._processes.values():
            self._go(process, late=self._follows)

    def _set_clock(self) -> bool:
        """Set when the graph's clock begins here; False while the host that tells it is not there.

        One host has it begin with its first sample; the others follow that host's.
        """
        if not self._follows:
            firsts = [p.first for p in self._processes.values() if p.first is not None]
            self._origin = min(firsts, default=0)
            self._began_ns = time.monotonic_ns() + HEAD_START_NS
            return True
        heard = [p.clock for p in self._processes.values() if p.clock is not None]
        if heard:
            self._origin, self._began_ns = heard[0]
        return bool(heard)

    def _go(self, process: PartProcess, *, late: bool) -> None:
        word = {"origin": self._origin, "began_ns": self._began_ns, "late": late}
        process.call({"call": "go", **word})
        process.joined = process.lives

    def _look(self, process: PartProcess) -> str | None:
        """Ask a process how it is; how it ended, if it did."""
        process.ask("state")
        return process.poll(time.monotonic())

    # ------------------------------------------------------------------ running

    def _serve(self, duration_s: float | None) -> Ended:
        end = None if duration_s is None else self._began_ns / 1e9 + duration_s
        while self._stop_asked is None:
            self._do_faults()
            for process in self._processes.values():
                self._attend(process)
            if all(process.over for process in self._processes.values()):
                return Ended.SOURCES
            if end is not None and time.monotonic() >= end:
                return Ended.DURATION
            self._show()
            time.sleep(POLL_S)
        return Ended.STOPPED

    def _do_faults(self) -> None:
        """Tell of the faults that are due, and kill whom they kill."""
        elapsed_s = (time.monotonic_ns() - self._began_ns) / 1e9 * self._speed
        while self._faults and self._faults[0].at_s <= elapsed_s:
            fault = self._faults.popleft()
            self._event("fault", fault.subject, fault.text)
            if fault.kills:
                self._processes[fault.subject].kill()

    def _attend(self, process: PartProcess) -> None:
        """Keep a process alive, let it go on where it was started anew, take its report."""
        if process.over:
            ended = process.ended_at
            if ended is not None and time.monotonic() - ended > FAREWELL_S:
                process.ended_at = None
                self._tell_gone(process)
            return
        how = self._look(process)
        if how is not None:
            self._lost(process, how)
        elif process.state is State.READY and process.joined < process.lives:
            self._rejoin(process)
        elif process.state is State.FAILED and process.text:
            text, process.text = process.text, ""
            self._event("process_failed", process.name, text)
        elif process.state is State.ENDED:
            process.ask("report")

    def _lost(self, process: PartProcess, how: str) -> None:
        shared_files.sweep()
        self._event("process_lost", process.name, f"its process {how}")
        reason = process.restart()
        if reason is None:
            return
        self._event("process_given_up", process.name, reason)
        self._tell_gone(process)

    def _tell_gone(self, process: PartProcess) -> None:
        """The streams of a process end for the others."""
        for other in self._processes.values():
            if not other.over:
                other.call({"call": "gone", "process": process.name})

    def _rejoin(self, process: PartProcess) -> None:
        self._go(process, late=True)
        for other in self._processes.values():
            if other.over:
                process.call({"call": "gone", "process": other.name})
        kept = [
            stage.name
            for stage in self._graph.stages
            if self._graph.placement.process_of[stage.name] == process.name
            and not stage.cls.stateless
            and not stage.contract.is_source
        ]
        # Where the two differ by much, it waited for a core, or for something else than one.
        away_s = time.monotonic() - process.lost_at
        text = (
            f"its process is back (start {process.lives}) after {away_s:.1f} s, in which it "
            f"computed for {process.cpu_s:.1f} s"
        )
        self._event("process_back", process.name, text)
        for name in kept:
            text = "began anew: what it kept in memory is lost, but for what it reads back itself"
            self._event("state_reset", name, text)

    def _show(self) -> None:
        now = time.monotonic()
        if now < self._page_due:
            return
        self._page_due = now + PAGE_S
        running = [p for p in self._processes.values() if p.state is State.RUNNING]
        for process in running:
            process.ask("page")
        processes = list(self._processes.values())
        elapsed_ns = time.monotonic_ns() - self._began_ns if self._began_ns else 0
        page = merged_page(self._graph, processes, self._events, elapsed_ns)
        if self._progress is not None:
            self._progress(snapshot_of(page, self._events))
        if self._board is not None:
            self._board.write(page)

    # ------------------------------------------------------------------ ending

    def _end(self) -> None:
        """Stop all parts and take their reports."""
        deadline = time.monotonic() + ENDING_S
        for process in self._processes.values():
            if not process.over:
                process.call({"call": "stop"})
        while time.monotonic() < deadline:
            waiting = [p for p in self._processes.values() if not p.over and p.state is not None]
            if not waiting:
                return
            for process in waiting:
                if (how := self._look(process)) is not None:
                    self._event("process_lost", process.name, f"its process {how} at the end")
                elif process.state is State.ENDED:
                    process.ask("report")
                elif process.state is State.FAILED:
                    process.given_up = True
                    self._event("process_failed", process.name, process.text)
            time.sleep(POLL_S)
        for process in self._processes.values():
            if not process.over and process.state is not None:
                text = f"did not end within {ENDING_S:g} s; its last books are missing"
                self._event("hung", process.name, text)
                process.past.append(process.page)

    @contextmanager
    def _all_closed(self) -> Iterator[None]:
        """No process and no shared memory is left, whatever happened."""
        try:
            yield
        finally:
            for process in self._processes.values():
                process.close()
            shared_files.sweep()

    def _on_signal(self, number: signal.Signals) -> None:
        text = f"by {number.name}: runs in flight end, what is queued is dropped"
        self._event("stopped", self._graph.name, text)
        self._stop_asked = number

    def _event(self, kind: str, subject: str, text: str) -> None:
        elapsed = max(0, time.monotonic_ns() - self._began_ns) if self._began_ns else 0
        at = self._origin + int(elapsed * self._speed)
        self._events.append(Event(at, kind, subject, text))
        if self._trace is not None:
            self._trace.told(kind, subject, text, at)
