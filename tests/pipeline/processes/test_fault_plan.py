from __future__ import annotations

from pipeline.graph.faults import GraphFaults
from pipeline.processes.fault_plan import planned_faults
from pipeline.scheduling.partition import Placement
from pipeline.scheduling.topology import Port
from pipeline.transport.bad_wire import WireFaults

PLACEMENT = Placement({"a": "main", "b": "far"}, {"main": "here", "far": "here"})
FAULTS = GraphFaults(
    kills={"main": [4, 8], "far": [2]},
    links={Port("a"): WireFaults(3, 5, delay_s=0.05, drops=0.1)},
)


def test_faults_come_in_time() -> None:
    plan = planned_faults(FAULTS, PLACEMENT, ("main", "far"))
    assert [(fault.at_s, fault.subject, fault.kills) for fault in plan] == [
        (0, "a/out", False),
        (0, "a/out", False),
        (2, "far", True),
        (3, "a/out", False),
        (4, "main", True),
        (5, "a/out", False),
        (8, "main", True),
    ]
    assert [fault.text for fault in plan if fault.subject == "a/out"] == [
        "its link is slow by 50 ms, as its faults say",
        "its link loses 10.0% of the messages, as its faults say",
        "its link is cut, as its faults say",
        "its link is restored",
    ]


def test_a_host_tells_of_its_own_processes_and_links_alone() -> None:
    assert [fault.subject for fault in planned_faults(FAULTS, PLACEMENT, ("far",))] == ["far"]
