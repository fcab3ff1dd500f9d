"""The process of one part of a graph: opens it, waits for the word, runs it, leaves its report."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from pipeline.drivers.exchange import Exchange
from pipeline.drivers.run import run_graph
from pipeline.drivers.shared_clock import ClockFollower
from pipeline.errors import OverflightError
from pipeline.graph.catalog import Catalog
from pipeline.graph.graph import Graph
from pipeline.measuring.profiler import Profiler
from pipeline.measuring.trace import Trace, saved_name
from pipeline.processes.control import Control, Stopped
from pipeline.processes.joint import Joint
from pipeline.scheduling.partition import Part
from pipeline.scheduling.topology import Port
from pipeline.transport.mailbox import Closed, Mailbox
from pipeline.transport.schema import PayloadSchema
from pipeline.transport.zenoh import Link, LinkOptions

if TYPE_CHECKING:  # a part that records nothing starts without the writer of its files
    from pipeline.recording.recorder import Recorder

#: How long an ended part keeps its report for the supervisor.
KEPT_S = 20.0

#: Loads the graph that a call describes.
Load = Callable[[Mapping[str, Any]], tuple[Graph, Catalog]]


#: A recorder for what a part does, where a call asks for one.
Record: TypeAlias = "Callable[[Mapping[str, Any], Graph], AbstractContextManager[Recorder | None]]"


def serve_part(mailbox: Mailbox, load: Load, record: Record) -> int:
    """Be the part that the first call describes, to its end; returns the exit code."""
    with contextlib.suppress(Closed):
        header, _ = mailbox.receive()
        mailbox.send({"state": "opening"})
        control, profiler = Control(mailbox), Profiler()
        serving = partial(_serve, control, profiler)
        threading.Thread(target=serving, name="control", daemon=True).start()
        try:
            _take_place(header)
            _run(header, load, record, control, profiler)
        except Stopped:
            return 0
        except OverflightError as error:
            control.failed(str(error), KEPT_S)
            return 1
        except Exception:  # a defect: the supervisor shows it
            control.failed(traceback.format_exc(), KEPT_S)
            return 1
    return 0


def _serve(control: Control, profiler: Profiler) -> None:
    with profiler.thread("control"):
        control.serve()


def schemas_of(graph: Graph, part: Part) -> Mapping[Port, PayloadSchema]:
    """What travels on each link of a part. Raises TransportError for what cannot."""
    contracts = {stage.name: stage.contract for stage in graph.stages}
    found: dict[Port, PayloadSchema] = {}
    for link in (*part.outgoing, *part.incoming):
        output = contracts[link.port.stage].output(link.port.name)
        assert output is not None
        found[link.port] = PayloadSchema.of(output.payload)
    return found


def _take_place(header: Mapping[str, Any]) -> None:
    """Before anything builds a pool of threads, which inherits both."""
    sys.path[:] = header["path"]
    if header["affinity"] is not None:
        try:
            os.sched_setaffinity(0, header["affinity"])
        except OSError as error:
            raise OverflightError(
                f"processes.{header['process']}.affinity: {error.strerror}; this machine has the "
                f"cores {', '.join(map(str, sorted(os.sched_getaffinity(0))))}"
            ) from None
    if header["nice"]:
        try:
            os.nice(header["nice"])
        except OSError as error:
            raise OverflightError(
                f"processes.{header['process']}.nice: {error.strerror}; below 0 it needs the right "
                "to (CAP_SYS_NICE)"
            ) from None


def _run(
    header: Mapping[str, Any],
    load: Load,
    record: Record,
    control: Control,
    profiler: Profiler,
) -> None:
    whole, catalog = load(header)
    graph, part = whole.part(header["process"])
    with contextlib.ExitStack() as stack:
        exchange = Exchange(
            header["run"],
            part,
            schemas_of(whole, part),
            profiler.enter_thread,
            tells_clock=header["tells_clock"],
            faults=whole.faults.links,
        )
        follower = ClockFollower(header["speed"])
        options = LinkOptions(header["listen"], header["connect"], header["zenoh"], header["run"])

        def open_link() -> None:
            link = stack.enter_context(Link(options))
            stack.callback(exchange.end)
            exchange.open(link)
            if header["follows"] is not None:
                follower.listen(header["run"], header["follows"], link)

        control.gone = exchange.gone
        joint = Joint(
            exchange,
            open_link,
            lambda first: control.ready(
                first, lambda: list(map(str, exchange.missing())), follower.known
            ),
            control.running,
            exchange.books,
        )
        failures: list[str] = []
        with _traced(header, failures) as trace:
            result = run_graph(
                graph,
                catalog,
                speed=header["speed"],
                profiler=profiler,
                trace=trace,
                board=control,
                recorder=stack.enter_context(record(header, graph)),
                joint=joint,
            )
        stack.close()  # the others hear the end of the streams before they are told that we ended
        control.ended(result.report | {"failures": [*result.failures, *failures]}, KEPT_S)


@contextlib.contextmanager
def _traced(header: Mapping[str, Any], failures: list[str]) -> Iterator[Trace | None]:
    """A trace where the call asks for one, saved however the run ends; `failures` says where not.

    Several processes of one host share the clock of its entries.
    """
    asked = header["trace"]
    if asked is None:
        yield None
        return
    trace = Trace(asked["entries"])
    try:
        yield trace
    finally:
        try:
            trace.save(Path(asked["folder"]) / saved_name(header["process"], header["life"]))
        except OSError as error:
            failures.append(f"processes.{header['process']}: its trace is lost: {error.strerror}")
