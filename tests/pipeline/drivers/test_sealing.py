from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from driving import Collect, beat, drive

from pipeline.message import Message
from pipeline.scheduling.topology import Input, Policy, Port, StageNode
from pipeline.stage import Stage


@dataclass(frozen=True)
class Frame:
    pixels: np.ndarray[Any, Any]
    camera: str


class Shoot(Stage):
    def __init__(self) -> None:
        self.shot: list[Frame] = []

    def process(self, x: Message[int]) -> Frame:
        self.shot.append(Frame(np.zeros((4, 4), np.uint8), "rgb"))
        return self.shot[-1]


@pytest.mark.parametrize("live", [True, False])
def test_receivers_share_one_frame_and_none_can_write_into_it(live: bool) -> None:
    receivers = {f"sink{i}": Collect() for i in range(3)}
    block = {"policy": Policy.BLOCK, "size": 9}
    nodes = [
        StageNode("source"),
        StageNode("camera", (Input("x", (Port("source"),), **block),)),  # type: ignore[arg-type]
        *(
            StageNode(name, (Input("x", (Port("camera"),), **block),), outputs=())  # type: ignore[arg-type]
            for name in receivers
        ),
    ]
    camera = Shoot()
    drive(nodes, {"camera": camera, **receivers}, {"source": beat(3, 5)}, live=live)
    for receiver in receivers.values():
        assert [payload for _, payload in receiver.seen] == camera.shot
        for _, frame in receiver.seen:
            with pytest.raises(ValueError, match="read-only"):
                frame.pixels[0, 0] = 1


def test_what_a_source_brings_is_sealed_too() -> None:
    frame = np.zeros(4)
    sink = Collect()
    nodes = [StageNode("source"), StageNode("sink", (Input("x", (Port("source"),)),), outputs=())]
    drive(nodes, {"sink": sink}, {"source": iter([Message.at(0, frame)])}, live=True)
    assert not sink.seen[0][1].flags.writeable
