"""A tapped scheduler decides as one without, and every event and decision becomes a row."""

from __future__ import annotations

import inspect
from typing import Any

from recording_runs import MS, topology

from pipeline.message import Message
from pipeline.recording.tap import Row, TappedScheduler
from pipeline.scheduling.events import Output, Start
from pipeline.scheduling.scheduler import Scheduler
from pipeline.scheduling.topology import Port


class Notebook:
    """Keeps all rows; has no room for messages of one port."""

    def __init__(self, full: Port | None = None) -> None:
        self.rows: list[Row] = []
        self._full = full

    def row(self, row: Row) -> None:
        self.rows.append(row)

    def message(self, port: Port, message: Message[Any]) -> bool:
        return port != self._full


def test_every_event_of_the_scheduler_is_tapped() -> None:
    events = [
        name
        for name, method in inspect.getmembers(Scheduler, inspect.isfunction)
        if not name.startswith("_") and "now" in inspect.signature(method).parameters
    ]
    assert len(events) >= 11
    assert [name for name in events if name not in vars(TappedScheduler)] == []


def test_a_row_says_what_came_and_what_followed() -> None:
    notebook = Notebook()
    scheduler = TappedScheduler(topology(), notebook)
    scheduler.publish(Port("lidar"), Message.at(10 * MS, 1, begin=9 * MS), 11 * MS)
    (start,) = scheduler.publish(Port("camera"), Message.at(20 * MS, 2), 22 * MS)
    assert isinstance(start, Start)
    (sink,) = scheduler.step_done(start.run, 23 * MS, [Output(0, "fused")])
    scheduler.time(24 * MS)
    scan, image, fused, time = notebook.rows
    assert scan[:3] == (0, "publish", 11 * MS)
    assert scan[3:] == (("lidar", "out", 10 * MS, -MS, 0), [("out", "lidar", "out", 0, 10 * MS)])
    assert image[:4] == (1, "publish", 22 * MS, ("camera", "out", 20 * MS, 0, 0))
    assert image[4] == [
        ("out", "camera", "out", 0, 20 * MS),
        ("set", "fuse", 10 * MS, (0, None), (("b", 0, "missing"),)),
        ("start", "fuse", 0, "process", None),
    ]
    assert fused[:4] == (2, "step_done", 23 * MS, (0, [(0, None, None, None)]))
    assert fused[4] == [
        ("out", "fuse", "out", 0, 10 * MS),
        ("end", "fuse", 0, "finished"),
        ("set", "sink", 10 * MS, (0,), ()),
        ("start", "sink", 0, "process", None),
    ]
    assert time == (3, "time", 24 * MS, (), [])
    assert sink.run.stage == "sink"


def test_a_message_that_found_no_room_is_named_among_what_followed() -> None:
    notebook = Notebook(full=Port("camera"))
    scheduler = TappedScheduler(topology(), notebook)
    scheduler.publish(Port("camera"), Message.at(5, 2), 6)
    followed = notebook.rows[0][-1]
    assert followed == [("out", "camera", "out", 0, 5), ("lost", "camera", "out", 0, 5)]
