"""The offline driver: nothing lost, and the same results whatever the machine does."""

from __future__ import annotations

import random
import time

from driving import MS, Apply, Collect, Pair, beat, drive
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.topology import Input, Missing, Policy, Port, StageNode, Sync


def _graph() -> list[StageNode]:
    return [
        StageNode("lidar"),
        StageNode("camera"),
        StageNode("segment", (Input("x", (Port("camera"),)),), stateless=True, max_in_flight=2),
        StageNode(
            "fuse",
            (
                Input("a", (Port("lidar"),)),
                Input(
                    "b",
                    (Port("segment"),),
                    Sync.NEAREST,
                    tolerance=50 * MS,
                    max_wait=0,
                    missing=Missing.PROCEED,
                ),
            ),
        ),
        StageNode("sink", (Input("x", (Port("fuse"),), policy=Policy.LATEST),), outputs=()),
    ]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32))
def test_the_results_do_not_depend_on_how_long_steps_take(seed: int) -> None:
    chance = random.Random(seed)
    sink = Collect()
    stages = {
        "segment": Apply(lambda x: time.sleep(chance.choice([0, 0, 0.001])) or x),
        "fuse": Pair(),
        "sink": sink,
    }
    sources = {"lidar": beat(10, 100), "camera": beat(30, 33.3)}
    ran = drive(_graph(), stages, sources, live=False)
    assert [payload for _, payload in sink.seen] == [(n, 3 * n) for n in range(10)]
    assert balanced(ran.ledger)


def test_offline_no_queue_drops_and_no_deadline_acts() -> None:
    sink = Collect()
    stages = {"segment": Apply(abs), "fuse": Pair(), "sink": sink}
    sources = {"lidar": beat(10, 100), "camera": beat(3, 300, delay_ms=5000)}
    ran = drive(_graph(), stages, sources, live=False)
    assert [payload[1] for _, payload in sink.seen] == [0, None, None, 1, None, None, 2] + [
        None
    ] * 3
    assert sum(page["dropped"].get("replaced", 0) for page in ran.ledger.values()) == 0


def test_a_duration_counts_graph_time() -> None:
    sink = Collect()
    nodes = [StageNode("source"), StageNode("sink", (Input("x", (Port("source"),)),), outputs=())]
    drive(nodes, {"sink": sink}, {"source": beat(100, 100)}, live=False, duration_s=1.0)
    assert len(sink.seen) == 10
