"""A table's networks, trained ahead of its rows: several at a time, each with the rows it fills.

A training keeps one core busy; a second thread in it gains little, a second training everything.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import partial

from rich.console import Console

from tools.tables.at_once import Work, at_once
from tools.tables.experiment import Experiment
from tools.tables.networks import needs
from tools.tables.order import TableOrder
from tools.tables.plan import plans
from tools.tables.simulated import fill_rows_of, unfilled

#: A network by its name in `paper.yaml`, and its seed.
Trained = tuple[str, int]


def train_ahead(order: TableOrder, table: str, console: Console) -> None:
    """Train what the unfilled rows of a table need and is not there, and fill those rows. Raises
    OverflightError, KeyboardInterrupt; what is done is kept."""
    experiment = Experiment.of(order, console)
    wanted = unfilled(experiment, table)
    if order.jobs < 2 or not wanted:
        return
    for flight in plans().tables[table].flights:
        experiment.world.observed(flight)
    done = 0
    every = list(rounds(wanted, experiment.networks.there))
    count = sum(map(len, every))
    console.print(f"{count} networks, {order.jobs} at a time", highlight=False)
    for together in every:
        pieces: dict[str, Work] = {}
        for name, seed in together:
            if (name, seed) not in experiment.networks.there:
                experiment.networks.prepare(name, seed)
            work = partial(_train, replace(order, jobs=1), table, name, seed)
            pieces[f"{name}, seed {seed}"] = work
        for piece in at_once(pieces, order.jobs):
            done += 1
            console.print(f"{piece}: done, {done} of {count}", highlight=False)


def rounds(wanted: Collection[Trained], there: Collection[Trained]) -> Iterator[list[Trained]]:
    """Networks that may be done together, in turn: what one needs is there or in a round before.

    Of those that are `there` only the wanted ones, whose rows are left to be filled.
    """
    left = list(dict.fromkeys(wanted))
    for name, seed in left:  # grows
        if (name, seed) not in there:
            left += [(n, seed) for n in needs(name) if (n, seed) not in (*left, *there)]
    while left:
        untrained = {one for one in left if one not in there}
        ready = [
            (name, seed)
            for name, seed in left
            if (name, seed) in there or not any((n, seed) in untrained for n in needs(name))
        ]
        yield ready
        left = [one for one in left if one not in ready]


def _train(order: TableOrder, table: str, name: str, seed: int, console: Console) -> None:
    """What one process does."""
    from tools.train.loop import Interrupted

    experiment = Experiment.of(order, console)
    try:
        experiment.networks.trained(name, seed)
    except Interrupted:
        raise KeyboardInterrupt from None
    fill_rows_of(experiment, table, name, seed)
