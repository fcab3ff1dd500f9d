"""The trace of a run of the paper's graph, held against the format and against the run's books."""

from __future__ import annotations

import gzip
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import pytest

from pipeline.drivers.run import RunResult, run_graph
from pipeline.graph.graph import Graph
from pipeline.measuring.trace import Trace
from pipeline.scheduling.partition import Placement, part_of
from pipeline.scheduling.topology import Input, Port, StageNode, Topology
from tools.load import open_graph
from tools.watching.trace import trace_events, write_trace
from tools.watching.trace_drawing import EDGES, STAGES, THREADS, Traced

FILE = Path(__file__).resolve().parents[3] / "graphs" / "emulated_uav.yaml"

CUT = Topology(
    (
        StageNode("camera"),
        StageNode("seen", (Input("image", (Port("camera"),)),), outputs=()),
    )
)
PLACED = Placement({"camera": "main", "seen": "far"}, {"main": "here", "far": "here"})

Events = list[dict[str, Any]]
Slice = tuple[int, float, float, str]  #: thread, from, to, name

#: The fields of "Trace Event Format" (2016) by phase, beside name, ph, pid and tid: required ones,
#: and the type of their values.
FIELDS: Mapping[str, Mapping[str, type]] = {
    "X": {"cat": str, "ts": Real, "dur": Real, "args": dict},
    "b": {"cat": str, "ts": Real, "id": str},
    "e": {"cat": str, "ts": Real, "id": str},
    "s": {"cat": str, "ts": Real, "id": int},
    "f": {"cat": str, "ts": Real, "id": int, "bp": str},
    "i": {"cat": str, "ts": Real, "s": str, "args": dict},
    "C": {"cat": str, "ts": Real, "args": dict},
    "M": {"ts": Real, "args": dict},
}
OPTIONAL = {"args"}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Graph, Trace, RunResult]:
    graph, catalog = open_graph(FILE, out=tmp_path_factory.mktemp("out"))
    trace = Trace()
    result = run_graph(graph, catalog, speed=None, duration_s=0.5, trace=trace)
    assert result.failures == ()
    return graph, trace, result


@pytest.fixture(scope="module")
def events(ran: tuple[Graph, Trace, RunResult]) -> Events:
    graph, trace, _ = ran
    return list(trace_events([Traced(trace, graph.topology)]))


def of(events: Events, *phases: str) -> Iterator[dict[str, Any]]:
    return (event for event in events if event["ph"] in phases)


def slices(events: Events) -> list[Slice]:
    return [
        (event["tid"], event["ts"], event["ts"] + event["dur"], event["name"])
        for event in of(events, "X")
    ]


def check_fields(events: Events) -> None:
    for event in events:
        fields = FIELDS[event["ph"]]
        assert isinstance(event["name"], str)
        assert isinstance(event["pid"], int)
        assert isinstance(event["tid"], int)
        for name, kind in fields.items():
            assert isinstance(event[name], kind), event
        assert event.keys() - fields.keys() - OPTIONAL == {"name", "ph", "pid", "tid"}
        assert event["ts"] >= 0.0
        assert event.get("dur", 0.0) >= 0.0
        assert event.get("s", "t") in ("g", "p", "t")
        assert event.get("bp", "e") == "e"
        if event["ph"] == "C":
            assert all(isinstance(value, Real) for value in event["args"].values())
        if event["ph"] == "M":
            key = "sort_index" if event["name"] == "process_sort_index" else "name"
            assert event["name"] in ("process_name", "process_sort_index", "thread_name")
            assert event["args"].keys() == {key}


@pytest.mark.slow
def test_every_event_has_the_documented_fields(events: Events) -> None:
    check_fields(events)
    assert {event["ph"] for event in events} >= set(FIELDS) - {"i"}


@pytest.mark.slow
def test_every_track_has_a_name(events: Events) -> None:
    named = {(e["pid"], e["tid"]) for e in of(events, "M") if e["name"] == "thread_name"}
    assert {(THREADS, e["tid"]) for e in of(events, "X", "s", "f")} <= named
    assert {(EDGES, e["tid"]) for e in of(events, "i") if e["pid"] == EDGES} <= named


@pytest.mark.slow
def test_slices_of_a_thread_lie_in_or_after_one_another(events: Events) -> None:
    tracks: dict[int, list[Slice]] = defaultdict(list)
    for each in slices(events):
        tracks[each[0]].append(each)
    for track in tracks.values():
        around: list[float] = []
        for _, begin, end, name in sorted(track, key=lambda each: (each[1], -each[2])):
            while around and around[-1] <= begin:
                around.pop()
            assert not around or end <= around[-1] + 1e-3, name
            around.append(end)


@pytest.mark.slow
def test_a_run_is_covered_by_its_waits_and_steps(events: Events) -> None:
    begun: dict[str, list[dict[str, Any]]] = defaultdict(list)
    covered: Counter[str] = Counter()
    for event in of(events, "b", "e"):
        open_ = begun[event["id"]]
        if event["ph"] == "b":
            open_.append(event)
            continue
        begin = open_.pop()
        assert begin["name"] == event["name"]
        length = event["ts"] - begin["ts"]
        if open_:
            covered[event["id"]] += length
        else:
            assert length == pytest.approx(covered[event["id"]], abs=0.01)
    assert not any(begun.values())


@pytest.mark.slow
def test_the_runs_are_those_of_the_books(
    events: Events, ran: tuple[Graph, Trace, RunResult]
) -> None:
    stages = ran[2].report["stages"]
    started = {name: page["runs"] for name, page in stages.items() if "ended" in page}
    found = Counter(event["name"] for event in of(events, "b") if event["name"] in stages)
    assert found == started


@pytest.mark.slow
def test_the_losses_are_those_of_the_ledger(
    events: Events, ran: tuple[Graph, Trace, RunResult]
) -> None:
    tracks = {event["tid"]: event["args"]["name"] for event in of(events, "M") if event["tid"]}
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for event in of(events, "i"):
        if event["cat"] == "loss":
            found[tracks[event["tid"]].replace(" to ", "->")][event["name"]] += 1
    dropped = {name: book["dropped"] for name, book in ran[2].report["edges"].items()}
    assert {name: dict(losses) for name, losses in found.items()} == {
        name: losses for name, losses in dropped.items() if losses
    }


def arrows(events: Events) -> Iterator[tuple[Slice, Slice]]:
    """The innermost slices at both ends of every arrow."""
    by_thread: dict[int, list[Slice]] = defaultdict(list)
    for each in slices(events):
        by_thread[each[0]].append(each)

    def around(event: dict[str, Any]) -> Slice:
        found = [s for s in by_thread[event["tid"]] if s[1] <= event["ts"] < s[2]]
        assert found, event
        return min(found, key=lambda s: s[2] - s[1])

    starts = {event["id"]: event for event in of(events, "s")}
    ends = {event["id"]: event for event in of(events, "f")}
    assert starts.keys() == ends.keys()
    for number, start in starts.items():
        assert start["ts"] <= ends[number]["ts"]
        yield around(start), around(ends[number])


@pytest.mark.slow
def test_arrows_lead_from_every_sensor_to_the_map(events: Events) -> None:
    origins: dict[Slice, set[Slice]] = defaultdict(set)
    for start, end in arrows(events):
        origins[end].add(start)
    last = max((s for s in slices(events) if s[3] == "semantic_map"), key=lambda s: s[1])
    seen, todo = {last}, [last]
    while todo:
        for origin in origins[todo.pop()] - seen:
            seen.add(origin)
            todo.append(origin)
    names = {name for *_, name in seen}
    assert names >= {"lidar", "rgb", "thermal", "odometry", "fuse_cloud"}
    assert names >= {f"segment_scan {step}" for step in ("prepare", "infer", "finish")}


@pytest.mark.slow
def test_a_set_tells_what_it_chose(events: Events) -> None:
    waits = [
        event["args"]
        for event in of(events, "b")
        if event["name"] == "wait for inputs and turn" and "trajectory" in event.get("args", {})
    ]
    assert waits
    for args in waits:
        assert args["trajectory"]["messages"] >= 2
    nearest = [args[name] for args in waits for name in args if name.startswith("boxes from")]
    assert nearest
    assert all(abs(edge["gap_ms"]) <= 70 for edge in nearest if isinstance(edge, dict))


@pytest.mark.slow
def test_what_is_left_of_a_longer_run_is_still_a_trace(
    ran: tuple[Graph, Trace, RunResult],
) -> None:
    graph, whole, _ = ran
    small = Trace(120)
    small._ring.extend(whole._ring)
    events = list(trace_events([Traced(small, graph.topology)]))
    check_fields(events)
    for _ in arrows(events):
        pass
    [told] = [event for event in of(events, "i") if event["pid"] == STAGES]
    assert told["name"] == f"{whole.recorded - 120} older entries were overwritten"


def traced_part(tmp_path: Path, process: str) -> Traced:
    """What a process of a small cut graph recorded of one message, saved and loaded again."""
    part = part_of(CUT, PLACED, process)
    trace = Trace()
    number, port = 7, ("camera", "out", 7, 500, 500, ())
    if process == "main":
        entries: list[tuple[Any, ...]] = [
            ("Published", 1_000, *port),
            ("Sampled", 900, 950, 1_100, "camera", "source camera"),
        ]
    else:
        entries = [
            ("Published", 1_400, *port),
            ("SetFormed", 1_500, "seen", 0, 500, (number,), ()),
            ("Stepped", 1_600, 1_700, "seen", 0, "process", None, "worker 1"),
            ("RunEnded", 1_800, "seen", 0, "finished"),
        ]
    trace._ring.extend((serial, *entry) for serial, entry in enumerate(entries))
    trace.save(tmp_path / "saved.trace")
    return Traced(Trace.load(tmp_path / "saved.trace"), part.topology, process)


def test_an_arrow_leads_from_a_sample_to_the_run_of_another_process_on_one_clock(
    tmp_path: Path,
) -> None:
    parts = [traced_part(tmp_path, process) for process in ("main", "far")]
    assert [len(each.trace.entries()) for each in parts] == [2, 4]
    events = list(trace_events(parts))
    check_fields(events)
    groups = {e["args"]["name"]: e["pid"] for e in of(events, "M") if e["name"] == "process_name"}
    assert groups == {"main: threads": 1, "far: threads": 4, "far: stages": 5}
    [start], [end] = of(events, "s"), of(events, "f")
    assert (start["pid"], end["pid"]) == (1, 4)
    assert (start["ts"], end["ts"]) == (0.1, 0.7)  # us since the first entry of all
    way = [e["ts"] for e in of(events, "b", "e") if e["name"] == "camera/out on its way"]
    assert way == [0.1, 0.5]


@pytest.mark.parametrize("name", ["trace.json", "trace.json.gz"])
def test_an_empty_trace_is_a_file_that_opens(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    write_trace([Traced(Trace(5), Topology(()))], "nothing", path)
    text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    page = json.loads(text)
    assert page["otherData"] == {"graph": "nothing", "entries": 0, "overwritten": 0}
    check_fields(page["traceEvents"])
