"""How far a run has come, where its end is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pipeline.stage import Source


class Course:
    """From where a run began (None: from the first instant that is asked for) to the last arrival
    of its sources, or for a duration; of sources without an end, for ever."""

    def __init__(
        self,
        sources: Mapping[str, Source],
        began: int | None,
        duration_s: float | None,
        tell: Callable[[str, str], None],
    ) -> None:
        """The sources are open. One that raises is told of, by its name, and has no known end."""
        lasts = []
        for name, source in sources.items():
            try:
                lasts.append(source.last_arrival())
            except Exception as error:
                tell(name, f"cannot say when its last message comes: {error}")
                lasts.append(None)
        known = [last for last in lasts if last is not None]
        self._last = max(known) if known and len(known) == len(lasts) else None
        self._duration_ns = None if duration_s is None else int(duration_s * 1e9)
        self._began = began

    def done(self, now: int) -> float | None:
        """The share of it that is behind, 0 to 1; None where nobody knows."""
        if self._began is None:
            self._began = now
        ends = [] if self._last is None else [self._last - self._began]
        if self._duration_ns is not None:
            ends.append(self._duration_ns)
        if not ends or (whole := min(ends)) <= 0:
            return None
        return min((now - self._began) / whole, 1.0)
