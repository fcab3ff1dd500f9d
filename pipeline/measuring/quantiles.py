"""A bounded sample of a stream of integers: exact count, quantiles over what is kept."""

from __future__ import annotations

from array import array

#: Values kept for quantiles. At 30 Hz that is half an hour; later ones replace random earlier ones.
RESERVOIR = 1 << 16


class Quantiles:
    """A bounded sample of integers with exact count and quantiles over what is kept."""

    __slots__ = ("_most", "_state", "_values", "count")

    def __init__(self, most: int = RESERVOIR) -> None:
        self._values = array("q")
        self._most = most
        self.count = 0
        self._state = 1

    def add(self, value: int) -> None:
        self.count += 1
        if len(self._values) < self._most:
            self._values.append(value)
            return
        # A linear congruential step is random enough to choose whom to replace, and repeatable.
        self._state = (self._state * 6364136223846793005 + 1442695040888963407) & (2**64 - 1)
        place = (self._state >> 16) % self.count
        if place < self._most:
            self._values[place] = value

    def at(self, fraction: float) -> int | None:
        """The nearest-rank quantile; None while empty."""
        if not self._values:
            return None
        ordered = sorted(self._values)
        return ordered[min(int(fraction * len(ordered)), len(ordered) - 1)]


def milliseconds(quantiles: Quantiles) -> dict[str, float | None]:
    """p50 and p99 in ms."""
    values = {"p50": quantiles.at(0.50), "p99": quantiles.at(0.99)}
    return {name: None if ns is None else round(ns / 1e6, 3) for name, ns in values.items()}
