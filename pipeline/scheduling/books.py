"""The books of a graph as plain values: what went over every edge, how every run ended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pipeline.scheduling.bounds import OutputPort
from pipeline.scheduling.stages import StageState


class Books:
    """Reads the scheduler's state; changes nothing."""

    def __init__(self, stages: Sequence[StageState], ports: Sequence[OutputPort]) -> None:
        self._stages = [stage for stage in stages if stage.inputs]
        self._ports = ports

    def ledger(self) -> dict[str, dict[str, Any]]:
        """Every edge's book by ``stage/port->stage/input``."""
        return {
            edge.name: edge.book.page(stage.unused(edge))
            for stage in self._stages
            for edges in stage.inputs
            for edge in edges
        }

    def runs(self) -> dict[str, dict[str, int]]:
        """Every stage's book of runs."""
        return {stage.node.name: stage.book.page(len(stage.runs)) for stage in self._stages}

    def marks(self) -> dict[str, dict[str, int]]:
        """Per stage with sync inputs: how many inputs were unsettled, missing, or held."""
        return {
            stage.node.name: {
                "unsettled": stage.book.unsettled,
                "missing": stage.book.missing,
                "held": stage.book.held,
            }
            for stage in self._stages
            if stage.sync
        }

    def refusals(self) -> dict[str, dict[str, int]]:
        """Per port that refused something: how often and why."""
        return {
            str(port.port): {str(reason): count for reason, count in port.refused.items()}
            for port in self._ports
            if port.refused
        }

    def statistics(self) -> dict[str, dict[str, Any]]:
        """What each stage holds now and held at most."""
        return {stage.node.name: stage.statistics() for stage in self._stages}
