from __future__ import annotations

import json

import pytest

from pipeline.scheduling.topology import Input, Policy, Port, Sync
from tools.drawing.diagram import Arrow, Box, Diagram, Socket, rule_of

MS = 1_000_000
SOURCE = (Port("camera"),)


@pytest.fixture
def diagram() -> Diagram:
    trigger = Socket("scan", "trigger", "")
    nearest = Socket("image", "nearest", "nearest ±70 ms")
    return Diagram(
        "pair",
        (
            Box("camera", "m:Camera", (), None, (), ("out",)),
            Box("lidar", "m:Lidar", (), None, (), ("out",)),
            Box("fuse", "m:Fuse", ("igpu", "cpu"), "net", (trigger, nearest), ("out",)),
            Box("file", "m:File", (), None, (Socket("cloud", "trigger", ""),), ()),
        ),
        (
            Arrow("lidar", "out", "fuse", "scan", "trigger", ""),
            Arrow("camera", "out", "fuse", "image", "nearest", "nearest ±70 ms"),
            Arrow("fuse", "out", "file", "cloud", "trigger", ""),
        ),
    )


@pytest.mark.parametrize(
    ("entry", "rule"),
    [
        (Input("image", SOURCE), ""),
        (Input("image", SOURCE, policy=Policy.BLOCK, size=20), "block 20"),
        (Input("image", SOURCE, policy=Policy.DROP_OLDEST, size=2), "drop oldest 2"),
        (Input("image", SOURCE, select="rgb"), "select rgb"),
        (Input("image", SOURCE, Sync.NEAREST, tolerance=70 * MS), "nearest ±70 ms"),
        (Input("image", SOURCE, Sync.EXACT), "exact"),
        (Input("image", SOURCE, Sync.LATEST, period=200 * MS), "latest, 5 Hz"),
    ],
)
def test_a_rule_is_said_in_a_few_words(entry: Input, rule: str) -> None:
    assert rule_of(entry) == rule


def test_mermaid_draws_every_box_and_edge(diagram: Diagram) -> None:
    text = diagram.mermaid()
    assert text.startswith("flowchart LR\n")
    assert 's0(["camera"])' in text
    assert 's2["fuse<br/><i>igpu → cpu</i>"]' in text
    assert 's0 -.->|"nearest ±70 ms"| s2' in text
    assert "s1 --> s2" in text


def test_dot_draws_every_box_and_edge(diagram: Diagram) -> None:
    text = diagram.dot()
    assert text.startswith('digraph "pair" {')
    assert '"camera" -> "fuse" [label="nearest ±70 ms", style=dashed];' in text
    assert text.count("->") == len(diagram.arrows)


def test_json_holds_boxes_and_arrows(diagram: Diagram) -> None:
    read = json.loads(diagram.json())
    assert [box["name"] for box in read["boxes"]] == ["camera", "lidar", "fuse", "file"]
    assert read["arrows"][1]["rule"] == "nearest ±70 ms"
