"""A process that writes a ring, or reads one, and then waits to be killed: one line per step."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pipeline.transport.envelope import Slot
from pipeline.transport.ring import RingReader, RingWriter


def say(*words: object) -> None:
    sys.stdout.write(" ".join(map(str, words)) + "\n")
    sys.stdout.flush()


def main(role: str, folder: str, file: str, at: str, generation: str) -> None:
    if role == "write":
        ring = RingWriter("killed", slots=2, budget=1 << 20, folder=Path(folder))
        ring.write(100, lambda target: target.fill(7), lambda slot: say(*slot))
    else:
        reader = RingReader(Path(folder))
        data = reader.read(Slot(file, int(at), int(generation)), 100)
        say("gone" if data is None else int(np.sum(data)))
    sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
