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
        say(*(ring.claim(100) or ()))
        ring.fill(b"", 100, lambda target: target.fill(7))
        say("filled")
    else:
        reader = RingReader(Path(folder))
        reading = reader.read(Slot(file, int(at), int(generation)))
        say("gone" if reading is None else int(np.sum(reading.data)))
    sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
