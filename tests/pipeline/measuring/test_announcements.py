from __future__ import annotations

import logging

from pipeline.measuring.announcements import logged_as_events
from pipeline.measuring.statistics import Event, Statistics


def test_warnings_of_any_logger_become_events_while_a_graph_runs_and_not_after() -> None:
    statistics = Statistics(offline=False)
    log = logging.getLogger("accelerators.some")
    with logged_as_events(statistics, lambda: 7):
        log.warning("fell back to %s", "the CPU")
        log.info("nothing to know")
    log.warning("after the run")
    assert statistics.events == [Event(7, "warning", "accelerators.some", "fell back to the CPU")]
