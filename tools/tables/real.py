"""Label propagation on real data: a drive teaches, the human labels of another drive judge.

Rows: the majority class, the best rule of height above ground, and networks from scratch that
learned from each scan's own images, from the camera-only map, and from that map mixed with labeled
scans of another LiDAR.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import DataError
from stages.kernels.metrics import confusion
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Scan
from tools.propagation.observing import Order
from tools.propagation.propagate import Product, propagate
from tools.propagation.settings import Settings, Teacher
from tools.tables.drive_boxes import judge_boxes
from tools.tables.rows import Rows, Verdict
from tools.tables.rules import by_height, height_above_ground, rules
from tools.tables.scan_judging import ScanNetwork, judge
from tools.tables.table import Line, Table
from tools.train.open_scans import open_scans

#: What the shared folder has of it.
DRIVE, JUDGED, OTHER = "data/kitti_drive_lite108", "data/semantickitti_00", "models/ika-pcl"
#: The training scans hold every fourth point, so the judged ones are split into four such.
THINNED = 4
SENSOR, GROUPS = "semantickitti", "street"
#: The car's own roof.
OWN_RADIUS_M = 2.5
#: How much of a mixture is the drive.
MAP_SHARE = 0.75


@dataclass(frozen=True, slots=True)
class RealOrder:
    """What a person asked for."""

    shared: Path
    output: Path
    seeds: int = 3
    steps: int = 1500
    width: float = 0.25
    recipe: str = "strong"
    threads: int = 1


def real_table(order: RealOrder, console: Console) -> Table:
    """Propagate, train, judge; what is there already is taken. Raises OverflightError, and
    `tools.train.loop.Interrupted` at Ctrl-C."""
    drive = order.shared / DRIVE
    for needed in (drive, order.shared / JUDGED):
        if not needed.is_dir():
            raise DataError(f"{needed}: is not there; this table needs it (--shared)")
    conditions = {
        "steps": order.steps,
        "width": order.width,
        "recipe": order.recipe,
        "drive": drive.name,
        "judged": JUDGED,
    }
    rows = Rows(order.output, conditions, console)
    remarks = _labels(order, drive, console)
    judged = list(thinned(order.shared / JUDGED))
    truth = np.concatenate([classes for _, classes in judged])
    heights = np.concatenate([height_above_ground(scan.points) for scan, _ in judged])
    lines = [
        Line("majority class", [rows.filled("majority", 0, lambda: _majority(truth))]),
        Line("best height rule", [rows.filled("height", 0, lambda: _best_rule(truth, heights))]),
    ]
    titles = {"overlay": "single overlay", "map": "camera-only map"}
    if (order.shared / OTHER).is_dir():
        titles["mix"] = "camera-only map + ika-pcl"
    trained: dict[str, list[Verdict]] = {key: [] for key in titles}
    for seed in range(order.seeds):
        for key in sorted(titles, key="map overlay mix".index):  # what matters most first
            trained[key].append(
                rows.filled(
                    key,
                    seed,
                    lambda k=key, s=seed: _trained(order, k, s, judged, console),  # type: ignore[misc]
                )
            )
    lines += [Line(titles[key], verdicts) for key, verdicts in trained.items()]
    lines[1] = Line(lines[1].title, lines[1].verdicts, note=str(lines[1].verdicts[0].facts["rule"]))
    said = (
        f"one drive of {drive.name} teaches, {len(judged) // THINNED} scans of {JUDGED} judge: one "
        f"place; SalsaNext x {order.width:g} from scratch, {order.steps} steps, recipe "
        f"{order.recipe}; sidewalk counts as road; barrier, person and bicycle are too few to judge"
    )
    return Table("Label propagation on real data", lines, (said, *remarks))


def thinned(folder: Path) -> Iterator[tuple[Scan, NDArray[np.uint8]]]:
    """The labeled scans of a folder, every fourth point of each four times, all points once."""
    source = open_scans(folder)
    for number in range(len(source)):
        one = source.read(number)
        for start in range(THINNED):
            part = slice(start, None, THINNED)
            scan = Scan(one.points[part], one.remission[part], None, None, "lidar")
            yield scan, one.classes[part]


def _labels(order: RealOrder, drive: Path, console: Console) -> list[str]:
    """Propagate from the map and from the overlay; what to say of them."""
    observed = order.output / "map"
    told = []
    vehicle = load_taxonomy().id("vehicle")
    for teacher in (Teacher.CAMERA_MAP, Teacher.OVERLAY):
        folder = order.output / teacher.value
        if not (folder / "report.json").is_file():
            settings = Settings(teacher=teacher, min_range_m=OWN_RADIUS_M)
            product = Product(folder, observed=observed)
            propagate(Order.of(drive, None), settings, product, console)
        source = open_scans(folder)

        def frame(number: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
            one = source.read(number)  # noqa: B023
            return one.points, one.classes

        report = yaml.safe_load((folder / "report.json").read_text())
        boxes = judge_boxes(drive / "boxes.json", frame, vehicle)
        share = report["labels"]["labeled_share"]
        told.append(
            f"{teacher.value} labels {100 * share:.1f} % of all points; "
            f"of the car boxes' points above 25 cm {100 * boxes.labeled_share:.0f} %, "
            f"{100 * boxes.vehicle_share:.1f} % of these vehicle"
        )
    return told


def _majority(truth: NDArray[np.uint8]) -> Verdict:
    road = np.full(len(truth), load_taxonomy().id("road"), dtype=np.int64)
    return _verdict(confusion(truth, road))


def _best_rule(truth: NDArray[np.uint8], height_m: NDArray[np.float64]) -> Verdict:
    """The best of the rules on the very scans that judge: the rule's own advantage."""
    found = {
        name: _verdict(confusion(truth, by_height(height_m, rule)), rule=name)
        for name, rule in rules().items()
    }
    return max(found.values(), key=lambda one: one.mean)


def _verdict(matrix: NDArray[np.int64], **facts: str) -> Verdict:
    """All five classes count, also the object that is few of the points."""
    return Verdict.of(matrix, GROUPS, min_points=1, facts=facts)


def _trained(
    order: RealOrder,
    key: str,
    seed: int,
    judged: list[tuple[Scan, NDArray[np.uint8]]],
    console: Console,
) -> Verdict:
    from tools.train.plan import Order as Training
    from tools.train.scan_training import ScanChoices, train_from_points

    data = order.output / key
    if key == "mix":
        data = _mixture(order)
    training = Training(
        data=data,
        output=order.output / f"seed{seed}" / key,
        steps=order.steps,
        seed=seed,
        threads=order.threads,
        license="CC BY-NC-SA 3.0",
        attribution="KITTI (Geiger et al.): not to be passed on",
        command="overflight evaluate --table real",
        quantized=False,
    )
    choices = ScanChoices(width=order.width, sensor=SENSOR, recipe=order.recipe)
    registry = train_from_points(training, choices, console)
    network = ScanNetwork.open(registry, SENSOR)
    return _verdict(judge(network, judged), steps=str(order.steps))


def _mixture(order: RealOrder) -> Path:
    path = order.output / "mix.yaml"
    content = {
        "sources": [
            {"path": "map", "share": MAP_SHARE},
            {"path": str((order.shared / OTHER).resolve()), "share": 1 - MAP_SHARE},
        ]
    }
    with whole_file(path) as file:
        file.write(yaml.safe_dump(content, sort_keys=False).encode())
    return path
