"""One report, one status page and one ledger of a graph that runs in several processes.

Everything here is plain values: the reports of the parts as `build_report` makes them, and their
status pages. Of a process that was killed the last page is known, half a second old at most.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from pipeline.drivers.snapshot import OutputSnapshot, Snapshot
from pipeline.graph.graph import Graph
from pipeline.measuring.statistics import Event
from pipeline.measuring.status import EVENTS_SHOWN, FORMAT, LOSSES
from pipeline.processes.books import merged_ledger
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.partition import links_between
from pipeline.scheduling.topology import Port

#: The pseudo-stage of a part that its transport's own threads are booked on.
TRANSPORT = "transport"


class Known(Protocol):
    """What is known of one process."""

    name: str
    report: dict[str, Any] | None
    page: dict[str, Any]
    past: list[dict[str, Any]]
    lives: int

    @property
    def pid(self) -> int | None: ...


def merged_report(
    graph: Graph, processes: Sequence[Known], events: Sequence[Event], wall_ns: int, ended: str
) -> dict[str, Any]:
    """The report of the whole graph, with the keys of a part's."""
    reports = {p.name: p.report for p in processes if p.report}
    ledger = merged_ledger(graph.topology, graph.placement, processes)
    owner = graph.placement.process_of
    here = {p.name: p for p in processes}
    links = _links(graph, here)
    stages = {
        stage.name: _stage(stage.name, here[owner[stage.name]])
        for stage in graph.stages
        if owner[stage.name] in here
    }
    return {
        "graph": graph.name,
        "wall_s": round(wall_ns / 1e9, 3),
        "offline": False,
        "stages": stages,
        "edges": ledger,
        "ledger_balanced": balanced(ledger) and all(link["balanced"] for link in links.values()),
        "outputs": {
            str(port): _output(str(port), teller)
            for node in graph.topology.stages
            for port in (Port(node.name, name) for name in node.outputs)
            if (teller := _teller(str(port), here.get(owner[node.name]), processes)) is not None
        },
        "devices": _devices(reports),
        "cpu": _cpu(reports.values()),
        "processes": {p.name: _process(p) for p in processes},
        "links": links,
        "refused": {
            port: counts
            for report in reports.values()
            for port, counts in report["refused"].items()
        },
        "failures": [text for report in reports.values() for text in report["failures"]]
        + [f"processes.{e.subject}: {e.text}" for e in events if e.kind in _FAILURES],
        "events": _told(reports.values(), events),
        "ended": ended,
    }


#: Events of the supervisor that make a run a failed one.
_FAILURES = ("process_failed", "process_given_up", "hung")


def merged_page(
    graph: Graph, processes: Sequence[Known], events: Sequence[Event], elapsed_ns: int
) -> dict[str, Any]:
    """The status of the whole graph, with the keys of a part's page."""
    pages = {p.name: p.report or p.page for p in processes if p.report or p.page}
    owner, here = graph.placement.process_of, {p.name: p for p in processes}
    stages: dict[str, Any] = {}
    devices: dict[str, Any] = {}
    for name, page in pages.items():
        its = page.get("stages", {}).items()
        stages |= {key: value for key, value in its if owner.get(key) == name}
        devices |= page.get("devices", {})
    first: dict[str, Any] = next(iter(pages.values()), {})
    return {
        "format": FORMAT,
        "graph": graph.name,
        "pid": os.getpid(),
        "began": first.get("began", time.time()),
        "speed": first.get("speed", 1.0),
        "state": "running" if pages else "opening",
        "elapsed_s": round(max(elapsed_ns, 0) / 1e9, 3),
        "cpu_cores": round(sum(page.get("cpu_cores", 0.0) for page in pages.values()), 4),
        "outputs": {
            str(port): _shown_output(
                str(port), _teller(str(port), here.get(owner[node.name]), processes)
            )
            for node in graph.topology.stages
            for port in (Port(node.name, name) for name in node.outputs)
        },
        "stages": stages,
        "devices": devices,
        "edges": merged_ledger(graph.topology, graph.placement, processes),
        "processes": {p.name: {"pid": p.pid, "restarts": max(p.lives - 1, 0)} for p in processes},
        "failures": [text for page in pages.values() for text in page.get("failures", [])],
        "events": _told(pages.values(), events)[-EVENTS_SHOWN:],
    }


def _told(pages: Iterable[Mapping[str, Any]], events: Sequence[Event]) -> list[dict[str, Any]]:
    """What the parts and their supervisor told, in the order of time."""
    told = [event for page in pages for event in page.get("events", [])]
    return sorted([*told, *(event.page() for event in events)], key=lambda event: event["at_s"])


def snapshot_of(page: Mapping[str, Any], events: Sequence[Event]) -> Snapshot:
    """What the progress line shows of a page."""
    outputs = {}
    for name, output in page["outputs"].items():
        ages = output.get("ages_ms") or {}
        outputs[name] = OutputSnapshot(
            output["count"], output["rate_hz"], max(ages.values(), default=None)
        )
    lost = sum(
        count
        for book in page["edges"].values()
        for reason, count in book["dropped"].items()
        if reason in LOSSES
    )
    return Snapshot(page["elapsed_s"], outputs, lost, events)


def _stage(name: str, process: Known) -> dict[str, Any]:
    """A stage as its process reported it; runs and errors of earlier lives are added."""
    past = [page["stages"][name] for page in process.past if name in page.get("stages", {})]
    if process.report and name in process.report["stages"]:
        page = dict(process.report["stages"][name])
    else:  # its process was lost for good, or left no report
        page = {
            "runs": 0,
            "rate_hz": None,
            "errors": 0,
            **dict.fromkeys(("latency_ms", "queued_ms", "ran_ms")),
            "cpu_ms": {},
            "steps": {},
            "stopped": True,
        }
    page["runs"] += sum(earlier["runs"] for earlier in past)
    page["errors"] += sum(earlier["errors"] for earlier in past)
    return page


def _teller(name: str, owner: Known | None, processes: Sequence[Known]) -> Known | None:
    """The process that tells of an output: its own, or of one of another host a reader here, to
    which it is what arrived."""
    if owner is not None:
        return owner
    readers = (p for p in processes if name in (p.report or p.page).get("outputs", {}))
    return next(readers, None)


def _output(name: str, process: Known) -> dict[str, Any]:
    past = [page["outputs"][name] for page in process.past if name in page.get("outputs", {})]
    if process.report and name in process.report["outputs"]:
        page = dict(process.report["outputs"][name])
    else:
        page = {
            "count": 0,
            "rate_hz": None,
            "longest_gap_ms": None,
            "age_from_stamp_ms": None,
            "age_from_arrival_ms": None,
            "age_by_stream_ms": {},
        }
    page["count"] += sum(earlier["count"] for earlier in past)
    return page


def _shown_output(name: str, process: Known | None) -> dict[str, Any]:
    """An output on the status page; nothing yet where its process has not said anything."""
    page: dict[str, Any] = {"count": 0, "rate_hz": 0.0, "silent_s": None, "ages_ms": {}}
    if process is not None:
        page |= process.page.get("outputs", {}).get(name, {})
        past = [earlier.get("outputs", {}).get(name) for earlier in process.past]
        page["count"] += sum(earlier["count"] for earlier in past if earlier)
    return page


def _process(process: Known) -> dict[str, Any]:
    report = process.report or {}
    page = {
        "pid": process.pid,
        "restarts": max(process.lives - 1, 0),
        "cpu_cores": report.get("cpu", {}).get("process_cores"),
        "reported": bool(process.report),
    }
    return page | ({"recording": report["recording"]} if "recording" in report else {})


def _devices(reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Every process opens devices of its own; a name that several use is told apart."""
    users: dict[str, list[str]] = {}
    for process, report in reports.items():
        for name in report["devices"]:
            users.setdefault(name, []).append(process)
    return {
        name if len(users[name]) == 1 else f"{name} in {process}": page
        for process, report in reports.items()
        for name, page in report["devices"].items()
    }


def _cpu(reports: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The account of all processes: what a part books on its senders is transport."""
    total = of_scheduler = 0.0
    stages: dict[str, float] = {}
    parts: dict[str, float] = {TRANSPORT: 0.0}
    devices: dict[str, float] = {}
    unknown: dict[str, float] = {}
    attributed = True
    for report in reports:
        cpu = report["cpu"]
        total += cpu["process_cores"]
        of_scheduler += cpu["scheduler_fraction"] * cpu["process_cores"]
        attributed &= cpu["attributed"]
        for name, cores in cpu["of_stages_cores"].items():
            if name == TRANSPORT or "@" in name:
                parts[TRANSPORT] += cores
            else:
                stages[name] = cores
        for kind, sums in (
            ("parts_cores", parts),
            ("device_processes_cores", devices),
            ("unknown_threads_cores", unknown),
        ):
            for name, cores in cpu[kind].items():
                sums[name] = round(sums.get(name, 0.0) + cores, 5)
    parts[TRANSPORT] = round(parts[TRANSPORT], 5)
    return {
        "process_cores": round(total, 4),
        "stages_cores": round(sum(stages.values()), 4),
        "scheduler_fraction": round(of_scheduler / total, 4) if total else 0.0,
        "of_stages_cores": stages,
        "parts_cores": parts,
        "attributed": attributed,
        "device_processes_cores": devices,
        "unknown_threads_cores": unknown,
    }


#: What the two ends of a link count.
_SENT = ("sent", "sent_whole", "failed")
_RECEIVED = ("received", "lost", "refused", "last_refusal", "bytes")


def _links(graph: Graph, here: Mapping[str, Known]) -> dict[str, Any]:
    """Every link as both ends counted it; balanced where what was sent arrived or is lost.

    An end counts since the last start of its process; where one of the two was started again, the
    counts need not agree, and ``since_the_last_start_of`` names it.
    """
    reports = {name: process.report for name, process in here.items() if process.report}
    found: dict[str, Any] = {}
    for link in links_between(graph.topology, graph.placement):
        sender = reports.get(link.origin, {}).get("links", {}).get("out", {}).get(link.sender)
        for target in link.targets:
            end = reports.get(target, {}).get("links", {}).get("in", {}).get(str(link.port))
            page = {
                **{key: sender[key] if sender else None for key in _SENT},
                **(end or {**dict.fromkeys(_RECEIVED), "refused": {}}),
            }
            started_again = [
                name for name in (link.origin, target) if name in here and here[name].past
            ]
            found[f"{link.port} to {target}"] = page | {
                "since_the_last_start_of": started_again,
                "balanced": bool(started_again) or _link_balances(page),
            }
    return found


def _link_balances(page: Mapping[str, Any]) -> bool:
    """Also where an end's books are gone with its process: then nothing contradicts them."""
    if page["sent"] is None or page["received"] is None:
        return True
    return bool(page["received"] + page["lost"] <= page["sent"])
