"""A process that publishes a counting stream every 5 ms, until it is killed."""

from __future__ import annotations

import itertools
import sys
import time

from transport_ends import CHANNEL, box, envelope

from pipeline.transport.outlet import INLINE_BYTES
from pipeline.transport.zenoh import Link, LinkOptions


def main(endpoint: str, run: str) -> None:
    with Link(LinkOptions(listen=[endpoint], run=run)) as link:
        link.advertise(CHANNEL)
        for number in itertools.count():
            link.publish(CHANNEL.key, envelope(number), box(INLINE_BYTES, str(number)))
            time.sleep(0.005)


if __name__ == "__main__":
    main(*sys.argv[1:])
