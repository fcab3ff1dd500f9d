from __future__ import annotations

import sys
from collections.abc import Sequence

import pytest

from pipeline.graph.placing import GraphProcess
from pipeline.processes.process import PartProcess
from pipeline.transport import child
from pipeline.transport.child import Child


class Deaf(Child):
    """A process that closes its end and lives on."""

    def _command(self, descriptor: int) -> Sequence[str]:
        program = f"import os, time; os.close({descriptor}); time.sleep(600)"
        return [sys.executable, "-c", program]


def test_a_process_that_only_closed_its_end_is_killed_and_can_be_started_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pipeline.processes.process.Child", Deaf)
    monkeypatch.setattr(child, "DEATH_S", 0.01)
    process = PartProcess(GraphProcess("far"), "none", {"call": "open"})
    try:
        process.start()
        first, how = process.pid, None
        while how is None:
            how = process.poll(0.0)
        assert how == "closed its connection"
        assert process.restart() is None
        assert process.pid != first
    finally:
        process.close()
