"""The paper's tables 3 to 6 on simulated flights, whose truth is exact.

Judged are flight A, whose labels were propagated (as in the paper), and flight B in another city,
which no network has seen. Per point the likeliest class against what the ray hit; the paper judges
against the class of the point's voxel in a map annotated by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.evaluation import map_confusion
from stages.kernels.metrics import WIDTH, confusion
from stages.kernels.propagation import confident_labels
from stages.kernels.voxels import pack
from stages.taxonomy import load_taxonomy
from stages.types import Cloud
from stages.voxel_map import VoxelMap
from tools.tables.evidence import classes_of, fused_evidence
from tools.tables.experiment import Experiment
from tools.tables.plan import RowPlan, TablePlan, plans
from tools.tables.rows import Verdict
from tools.tables.scan_judging import ScanNetwork
from tools.tables.table import Line, Table
from tools.tables.world import VOXEL_M, JudgedScan, World

FLIGHTS = {
    "flight_a": "flight A, whose labels were propagated",
    "flight_b": "city B, held out",
    "disaster": "a disaster site in another city",
}
WHY = (
    "read the paper's figures for their order: its world, its sensors and its 20,000 scans of "
    "SemanticKITTI are others. One set of weights sees both image sizes here; and both LiDARs "
    "report a material alike, so that intensity helps, and adapting its mean does not"
)

#: How a row is judged on a flight.
Judge = Callable[[World, RowPlan, ScanNetwork | None, str], Verdict]


def tables_of(experiment: Experiment, name: str) -> list[Table]:
    """One table for each judged flight. Raises OverflightError, `tools.train.loop.Interrupted`."""
    plan = plans().tables[name]
    verdicts = filled(experiment, plan, judge_row)
    title = f"Table {name}: {plan.title}" if plan.in_paper else plan.title
    return [
        Table(
            f"{title} ({FLIGHTS[flight]})",
            [_line(row, verdicts[key, flight]) for key, row in plan.rows.items()],
            (*experiment.conditions(), *([WHY] if plan.in_paper else [])),
        )
        for flight in plan.flights
    ]


def filled(
    experiment: Experiment, plan: TablePlan, judge: Judge, prefix: str = ""
) -> dict[tuple[str, str], list[Verdict]]:
    """The verdicts of each (row, flight), one per seed; what is there already is read. The files of
    another judge have another `prefix`."""
    verdicts: dict[tuple[str, str], list[Verdict]] = {}
    for seed in range(experiment.seeds):
        for key, row, flight in _judged(plan):
            fill = _filler(experiment, row, flight, seed, judge)
            verdict = experiment.rows.filled(f"{prefix}{row.judged}-{flight}", seed, fill)
            verdicts.setdefault((key, flight), []).append(verdict)
    return verdicts


def _judged(plan: TablePlan) -> Iterator[tuple[str, RowPlan, str]]:
    """Each row, by its key, on each flight."""
    for key, row in plan.rows.items():
        for flight in plan.flights:
            yield key, row, flight


def unfilled(experiment: Experiment, table: str) -> list[tuple[str, int]]:
    """The networks and seeds whose rows of a table are not all filled."""
    plan, read = plans().tables[table], experiment.rows.read
    return list(
        dict.fromkeys(
            (row.network, seed)
            for seed in range(experiment.seeds)
            for _, row, flight in _judged(plan)
            if row.network is not None and read(f"{row.judged}-{flight}", seed) is None
        )
    )


def fill_rows_of(experiment: Experiment, table: str, network: str, seed: int) -> None:
    """Fill the rows of a table that judge one network."""
    plan = plans().tables[table]
    for _, row, flight in _judged(plan):
        if row.network == network:
            fill = _filler(experiment, row, flight, seed, judge_row)
            experiment.rows.filled(f"{row.judged}-{flight}", seed, fill)


def _line(row: RowPlan, verdicts: Sequence[Verdict]) -> Line:
    outside = [one.facts.get("person_recall_out_of_view") for one in verdicts]
    known = [float(one) for one in outside if one is not None]
    note = f"persons out of every camera's view: recall {np.mean(known):.0f} %" if known else ""
    return Line(row.title, verdicts, row.mean, note)


def _filler(
    experiment: Experiment, row: RowPlan, flight: str, seed: int, judge: Judge
) -> Callable[[], Verdict]:
    def fill() -> Verdict:
        network = None
        if row.network is not None:
            network = experiment.networks.open(row.network, seed, row.size, row.normal)
        return judge(experiment.world, row, network, flight)

    return fill


def judge_row(world: World, row: RowPlan, network: ScanNetwork | None, flight: str) -> Verdict:
    """As a map where the row says so, else scan by scan."""
    if row.map:
        return judge_map(world, row, network, flight)
    return judge_scans(world, row, network, flight)


def judge_scans(world: World, row: RowPlan, network: ScanNetwork | None, flight: str) -> Verdict:
    """Point by point; and persons where no camera looks."""
    total = np.zeros((WIDTH, WIDTH), dtype=np.int64)
    person = load_taxonomy().id("person")
    unseen = found = 0
    for scan in world.judged(flight):
        said = classes_of(cloud_of(scan, row, network))
        judged = scan.truth > 0
        if row.view == "camera":
            judged &= scan.visible
            if network is None:  # what the images say nothing of is no part of their row
                judged &= said > 0
        total += confusion(scan.truth[judged], said[judged])
        hidden = (scan.truth == person) & ~scan.visible
        unseen += int(np.count_nonzero(hidden))
        found += int(np.count_nonzero(said[hidden] == person))
    facts: dict[str, Any] = {"person_points_out_of_view": unseen}
    if unseen and row.view == "all":
        facts["person_recall_out_of_view"] = 100 * found / unseen
    return Verdict.of(total, "paper", facts=facts)


def cloud_of(scan: JudgedScan, row: RowPlan, network: ScanNetwork | None) -> Cloud:
    """What a row says of a scan's points."""
    cameras = row.fused or network is None
    return fused_evidence(scan.observation, network, cameras=cameras)


def judge_map(world: World, row: RowPlan, network: ScanNetwork | None, flight: str) -> Verdict:
    """Voxel by voxel against the true map, over the voxels that any return of the flight hit."""
    classes = len(load_taxonomy())
    built = VoxelMap(voxel_m=VOXEL_M, classes=classes)
    everything = VoxelMap(voxel_m=VOXEL_M, classes=classes)
    for scan in world.judged(flight):
        pose = scan.observation.map_from_sensor
        if pose is None:
            continue
        cloud = cloud_of(scan, row, network)
        built.integrate(cloud, pose, scan.observation.stamp)
        hit = Cloud(cloud.points, cloud.log_scores, scan.truth > 0, pose, cloud.sensor)
        everything.integrate(hit, pose, scan.observation.stamp)
    said, hit_voxels = built.snapshot(), everything.snapshot()
    true = world.true_map(flight)
    among = _rows_in(true.indices, hit_voxels.indices)
    matrix = map_confusion(
        true.indices[among],
        true.classes[among].astype(np.int64),
        said.indices,
        confident_labels(said.log_scores, classes, 0.0).astype(np.int64),
        missing_counts=row.view == "all",
    )
    return Verdict.of(matrix, "paper", facts={"voxels": len(said.indices)})


def _rows_in(voxels: NDArray[np.int32], others: NDArray[np.int32]) -> NDArray[np.int64]:
    """The rows of voxels (n, 3) that are among the others (m, 3)."""
    return np.flatnonzero(np.isin(pack(voxels), pack(others)))
