"""What all rows and figures of one order share: the world, the networks, the rows filled so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from rich.console import Console

from tools.tables.networks import Networks
from tools.tables.order import TableOrder
from tools.tables.plan import scale_named
from tools.tables.rows import Rows
from tools.tables.world import World


@dataclass(frozen=True, slots=True)
class Experiment:
    """One world at one scale."""

    world: World
    networks: Networks
    rows: Rows
    seeds: int
    steps: int
    quick: bool
    threads: int
    console: Console

    @classmethod
    def of(cls, order: TableOrder, console: Console) -> Self:
        """Raises DataError where rows of other conditions lie in the order's folder."""
        name = "quick" if order.quick else "full"
        scale = scale_named(name)
        steps = order.steps or scale.steps
        world = World(order.output / name, scale, console)
        conditions = {"scale": scale.model_dump(mode="json"), "steps": steps}
        return cls(
            world,
            Networks(world, steps, order.threads, console),
            Rows(world.folder, conditions, console),
            1 if order.quick else order.seeds,
            steps,
            order.quick,
            order.threads,
            console,
        )

    def conditions(self) -> list[str]:
        """In words, for below a table."""
        scale = self.world.scale
        told = [
            f"{self.steps} steps of {scale.batch} half scans, SalsaNext x {scale.width:g}, "
            f"flights of {scale.flight_a.preset['duration_s']:g} s"
        ]
        if self.quick:
            told.append(
                "--quick shows that the table can be made; its networks have hardly learned"
            )
        return told
