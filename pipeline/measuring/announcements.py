"""What devices and stages log while a graph runs becomes events of its report."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator

from pipeline.measuring.statistics import Statistics


@contextlib.contextmanager
def logged_as_events(statistics: Statistics, now: Callable[[], int]) -> Iterator[None]:
    """Enter warnings and errors of every logger as events; `now` gives their time.

    A fall-back that only the terminal saw would be missing where it counts, in the report.
    """
    handler = _Events(statistics, now)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)


class _Events(logging.Handler):
    def __init__(self, statistics: Statistics, now: Callable[[], int]) -> None:
        super().__init__(logging.WARNING)
        self._statistics = statistics
        self._now = now

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = record.getMessage()
        except Exception:  # a wrong format string must not end the run
            self.handleError(record)
            return
        self._statistics.event("warning", record.name, text, self._now())
