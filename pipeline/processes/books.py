"""One ledger of what the parts of a graph kept apart.

The edge from a stage in one process to a stage in another has two books: that of the sender, whose
deliveries are messages on their way, and that of the reader. What the reader's end of the link
missed is `lost_in_transport`, and so is what a killed process may or may not have received; what
was on its way when the run ended is `end`. What a killed process held ends as `stage_stopped`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol

from pipeline.scheduling.events import Reason
from pipeline.scheduling.partition import Placement, links_between
from pipeline.scheduling.topology import Topology


class Books(Protocol):
    """What a process wrote down: its report, else its last page, and those of earlier lives."""

    name: str
    report: dict[str, Any] | None
    page: dict[str, Any]
    past: list[dict[str, Any]]


def merged_ledger(
    topology: Topology, placement: Placement, processes: Sequence[Books]
) -> dict[str, dict[str, Any]]:
    """Every edge's book by ``stage/port->stage/input``, as in one process."""
    books = {process.name: process for process in processes}
    senders = {
        (link.port, target): link.sender
        for link in links_between(topology, placement)
        for target in link.targets
    }
    ledger: dict[str, dict[str, Any]] = {}
    for node in topology.stages:
        target = placement.process_of[node.name]
        for rule in node.inputs:
            for port in rule.sources:
                edge = f"{port}->{node.name}/{rule.name}"
                read = _sum(books.get(target), edge)
                origin = placement.process_of[port.stage]
                if origin == target:
                    if target in books:
                        ledger[edge] = _page(read)
                    continue
                if origin not in books and target not in books:
                    continue
                sent = None
                if origin in books:
                    sender = senders[port, target]
                    sent = _sum(books[origin], f"{port}->{sender}/message")
                if sent is None:  # on another host: what this end of the link noticed
                    noticed = _noticed(books[target], str(port))
                    read.produced += noticed
                    read.dropped[str(Reason.LOST_IN_TRANSPORT)] += noticed
                missed = _missed(books.get(origin), books.get(target), str(port))
                ledger[edge] = _across(sent, read, missed, reads_here=target in books)
    return ledger


class _Sum:
    """One edge's book over all lives of a process."""

    def __init__(self) -> None:
        self.produced = self.delivered = self.reused = self.in_flight = 0
        self.dropped: Counter[str] = Counter()

    @property
    def ended(self) -> int:
        return self.delivered + self.dropped.total()


def _sum(process: Books | None, edge: str) -> _Sum:
    total = _Sum()
    if process is None:
        return total
    last = process.report or process.page
    for page, dead in [*((page, True) for page in process.past), (last, False)]:
        book = page.get("edges", {}).get(edge)
        if book is None:
            continue
        total.produced += book["produced"]
        total.delivered += book["delivered"]
        total.reused += book["reused"]
        total.dropped.update(book["dropped"])
        if dead and book["in_flight"]:
            total.dropped[str(Reason.STAGE_STOPPED)] += book["in_flight"]
        elif not dead:
            total.in_flight += book["in_flight"]
    return total


def _missed(origin: Books | None, target: Books | None, port: str) -> int | None:
    """What the reader's end knows to be lost; None where a process, and its books, were lost."""
    for process in (origin, target):
        if process is None or process.past or not process.report:
            return None
    assert target is not None
    return _noticed(target, port)


def _noticed(target: Books, port: str) -> int:
    """Messages that the last life of a reader missed or refused, once it has reported."""
    if not target.report:
        return 0
    refused = target.report["refused"].get(port, {})
    return int(target.report["links"]["in"][port]["lost"]) + sum(map(int, refused.values()))


def _across(
    sent: _Sum | None, read: _Sum, missed: int | None, *, reads_here: bool
) -> dict[str, Any]:
    """The book of an edge between processes; with one end on another host, what is known here."""
    if sent is None:
        return _page(read)
    if not reads_here:
        return _page(sent)
    total = _Sum()
    # The sender's page may be older than the reader's.
    total.produced = max(sent.produced, sent.dropped.total() + read.produced)
    total.delivered, total.reused = read.delivered, read.reused
    total.dropped = sent.dropped + read.dropped
    total.in_flight = sent.in_flight + read.in_flight
    lost = total.produced - sent.dropped.total() - sent.in_flight - read.produced
    on_its_way = 0 if missed is None else max(0, lost - missed)
    total.dropped[str(Reason.LOST_IN_TRANSPORT)] += lost - on_its_way
    total.dropped[str(Reason.END)] += on_its_way
    return _page(total)


def _page(book: _Sum) -> dict[str, Any]:
    return {
        "produced": book.produced,
        "delivered": book.delivered,
        "reused": book.reused,
        "dropped": {reason: count for reason, count in sorted(book.dropped.items()) if count},
        "in_flight": book.in_flight,
    }
