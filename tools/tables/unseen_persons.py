"""Fig 12: persons where no camera looks, as the operator, who always walks behind the vehicle.

Nobody labels them, so that what a network says of them is what it has learned from others.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.taxonomy import load_taxonomy
from tools.propagation.pictures import range_panels
from tools.tables.evidence import classes_of
from tools.tables.experiment import Experiment
from tools.tables.map_pictures import write_picture
from tools.tables.plan import RowPlan, plans
from tools.tables.rows import Verdict
from tools.tables.scan_judging import ScanNetwork
from tools.tables.simulated import FLIGHTS, cloud_of, filled
from tools.tables.table import Line, Table
from tools.tables.world import JudgedScan, World

NAME = "12"
#: Persons of fewer returns than this, far off, get no box in the picture.
BOXED = 10
#: Where a return of a person is.
IN_VIEW, OUT_NOW, NEVER = "in view", "out of view in this scan", "never in view"


def recall_tables(experiment: Experiment) -> list[Table]:
    """The recall of persons by where the cameras look, on each flight. Raises OverflightError,
    `tools.train.loop.Interrupted`."""
    plan = plans().tables[NAME]
    verdicts = filled(experiment, plan, judge_persons, "persons-")
    tables = []
    for flight in plan.flights:
        first = verdicts[next(iter(plan.rows)), flight][0]
        told = (
            f"{first.facts['persons_never_in_view']} of {first.facts['persons']} persons were in "
            f"no color camera's image in any scan, hidden or not: {first.points[NEVER]:,} returns "
            f"({first.points[IN_VIEW]:,} in view, {first.points[OUT_NOW]:,} out of it in a scan)"
        )
        lines = [Line(row.title, verdicts[key, flight]) for key, row in plan.rows.items()]
        conditions = (told, *experiment.conditions())
        title = f"{plan.title} ({FLIGHTS[flight]})"
        tables.append(Table(title, lines, conditions, "recall in %", NEVER))
    return tables


def draw_unseen_persons(experiment: Experiment, folder: Path) -> list[Path]:
    """The scan of flight A with most returns of persons who are never in view: what is true, and
    what the rows' networks say of it; boxes are around these persons."""
    world, plan = experiment.world, plans().tables[NAME]
    never = persons_never_in_view(world, "flight_a")
    person = load_taxonomy().id("person")
    best: tuple[int, JudgedScan] | None = None
    for scan in world.judged("flight_a"):
        count = int(np.count_nonzero(np.isin(scan.things, never) & (scan.truth == person)))
        if best is None or count > best[0]:
            best = count, scan
    assert best is not None  # `judged` raises where there are no scans
    scan = best[1]
    labelings: dict[str, NDArray[np.uint8] | None] = {"true": scan.truth}
    for row in plan.rows.values():
        assert row.network is not None
        network = experiment.networks.open(row.network, 0, row.size, row.normal)
        labelings[row.title] = classes_of(cloud_of(scan, row, network)).astype(np.uint8)
    everyone = [np.flatnonzero(scan.things == thing) for thing in never]
    marked = [points for points in everyone if len(points) >= BOXED]
    picture = range_panels(scan.observation, labelings, marked)
    return [write_picture(folder / f"figure-{NAME}.png", picture)]


def judge_persons(world: World, row: RowPlan, network: ScanNetwork | None, flight: str) -> Verdict:
    """Which share of the returns of persons is said to be person."""
    person = load_taxonomy().id("person")
    returns = ReturnsOfThings()
    for scan in world.judged(flight):
        said = classes_of(cloud_of(scan, row, network))
        returns.add(scan, scan.truth == person, said == person)
    points, found = returns.by_place()
    recall = {where: 100 * found[where] / points[where] for where in points if points[where]}
    return Verdict(
        mean=recall.get(NEVER, float("nan")),
        classes={where: recall.get(where) for where in (IN_VIEW, OUT_NOW)},
        points=points,
        facts={
            "persons": int(np.count_nonzero(returns.points.sum(axis=0))),
            "persons_never_in_view": len(returns.never()),
        },
    )


class ReturnsOfThings:
    """How many returns of each thing lie in a camera's image and out of it, and are right."""

    def __init__(self) -> None:
        things = np.iinfo(np.uint16).max + 1
        self.points = np.zeros((2, things), dtype=np.int64)  #: in view, out of view
        self.found = np.zeros((2, things), dtype=np.int64)

    def add(self, scan: JudgedScan, mine: NDArray[np.bool_], right: NDArray[np.bool_]) -> None:
        """One scan: which points (n,) are asked about, and of which the answer is right."""
        for place, mask in enumerate((mine & scan.visible, mine & ~scan.visible)):
            things = self.points.shape[1]
            self.points[place] += np.bincount(scan.things[mask], minlength=things)
            self.found[place] += np.bincount(scan.things[mask & right], minlength=things)

    def never(self) -> NDArray[np.int64]:
        """The things of which no return lay in an image."""
        return np.flatnonzero((self.points[0] == 0) & (self.points[1] > 0))

    def by_place(self) -> tuple[dict[str, int], dict[str, int]]:
        """Returns, and right ones, by where they are."""
        never = np.zeros(self.points.shape[1], dtype=np.bool_)
        never[self.never()] = True
        sums = [
            {
                IN_VIEW: int(counts[0].sum()),
                OUT_NOW: int(counts[1, ~never].sum()),
                NEVER: int(counts[1, never].sum()),
            }
            for counts in (self.points, self.found)
        ]
        return sums[0], sums[1]


def persons_never_in_view(world: World, flight: str) -> NDArray[np.int64]:
    """The persons of whom no return of the flight lies in a color camera's image."""
    person = load_taxonomy().id("person")
    returns = ReturnsOfThings()
    for scan in world.judged(flight):
        mine = scan.truth == person
        returns.add(scan, mine, mine)
    return returns.never()
