"""What the tables' networks learn from, and a network judged from its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("torch", reason="training needs the extra 'train'")

from rich.console import Console

from stages.types import Scan
from tools.propagation.settings import Teacher
from tools.tables.networks import Networks, _measured
from tools.tables.plan import plans, scale_named
from tools.tables.real import thinned
from tools.tables.scan_judging import ScanNetwork, judge
from tools.train import scan_training
from tools.train.plan import Order, Plan
from tools.train.scan_sources import LabeledPoints
from tools.train.scan_training import ScanChoices

QUIET = Console(quiet=True)
ROAD = 3


def sequence(folder: Path) -> Path:
    """One scan of a road, in SemanticKITTI's layout."""
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    rows = np.zeros((4000, 4), "<f4")
    rows[:, :3] = np.random.default_rng(0).uniform([-20, -20, -1.8], [20, 20, -1.7], (4000, 3))
    rows.tofile(folder / "velodyne/000000.bin")
    np.full(4000, 40, "<u4").tofile(folder / "labels/000000.label")
    return folder


class World:
    """Folders in place of flights."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scale = scale_named("quick")

    def flights(self, name: str) -> list[Path]:
        return [self.folder / f"{name}-{k}.mcap" for k in (1, 2)]


class Placed(Networks):
    """Networks whose labels and views are there already; notes which were asked for."""

    def __init__(self, world: World) -> None:
        super().__init__(world, 10, 1, QUIET)  # type: ignore[arg-type]
        self.labeled: list[tuple[str, Teacher]] = []
        self.observers: list[str] = []

    def _labeled(self, flight: str, teacher: Teacher, observed: Path, folder: Path) -> Path:
        self.labeled.append((flight, teacher))
        return folder

    def _observed_with(self, flight: str, name: str, seed: int, folder: Path) -> Path:
        self.observers.append(f"{name}-{seed} on {flight}")
        return folder

    def _views(self, flight: Path) -> Path:
        return flight.with_suffix(".views")


@pytest.mark.parametrize("name", sorted(plans().networks))
def test_a_mixture_holds_its_parts_each_normalized_as_its_sensor(name: str, tmp_path: Path) -> None:
    networks = Placed(World(tmp_path))
    network = plans().networks[name]
    entries = yaml.safe_load(networks._mixture(name, network, 0).read_text())["sources"]
    shares: dict[str, float] = {}
    for entry in entries:
        shares[entry["sensor"]] = shares.get(entry["sensor"], 0) + entry["share"]
    target = sum(v for k, v in network.parts.items() if k not in ("source", "views"))
    expected = {"source": network.parts["source"], "views": network.parts.get("views", 0)}
    assert {k: v for k, v in (expected | {"adapted": target}).items() if v} == shares
    hidden = [entry for entry in entries if entry.get("labels") is False]
    assert len(hidden) == ("unlabeled" in network.parts)


def test_a_further_iteration_learns_from_maps_with_the_retrained_network_in_them(
    tmp_path: Path,
) -> None:
    networks = Placed(World(tmp_path))
    networks._mixture("again-disaster", plans().networks["again-disaster"], 2)
    assert networks.observers == ["views-map-2 on flight_a", "views-map-2 on disaster"]
    assert set(networks.labeled) == {
        ("flight_a", Teacher.FUSED_MAP), ("disaster", Teacher.FUSED_MAP),
    }  # fmt: skip
    networks._mixture("views-fused", plans().networks["views-fused"], 2)
    assert networks.observers[-1] == "source-2 on flight_a"


class Scans:
    """One scan, as a source."""

    told = "a test"

    def __init__(self, points: list[list[float]], remission: list[float]) -> None:
        rows = np.array(points, np.float32)
        nothing = np.zeros(len(rows), np.uint8)
        self.scan = LabeledPoints(rows, np.array(remission, np.float32), nothing, None)

    def __len__(self) -> int:
        return 1

    def read(self, _: int) -> LabeledPoints:
        return self.scan


def test_the_figures_of_a_sensor_are_those_of_returns_beyond_the_vehicle() -> None:
    far, near, none = [[3.0, 4.0, 0], [0, 0, -5.0]], [0.2, 0.0, 0.3], [0.0, 0, 0]
    measured = _measured(iter([Scans([*far, near, none], [0.2, 0.4, 1.0, 0.9])]))
    np.testing.assert_allclose(measured.mean, [5.0, 1.5, 2.0, -2.5, 0.3], atol=1e-6)


def test_a_scan_is_split_into_thinner_ones_without_losing_a_point(tmp_path: Path) -> None:
    parts = list(thinned(sequence(tmp_path / "00")))
    assert [len(scan.points) for scan, _ in parts] == [1000] * 4
    every = np.sort(np.concatenate([scan.points[:, 0] for scan, _ in parts]))
    whole = np.fromfile(tmp_path / "00/velodyne/000000.bin", "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(every, np.sort(whole[:, 0]))


def test_a_network_is_judged_from_its_file_by_every_point(tmp_path: Path) -> None:
    network = ScanNetwork.open(None, "os0_128_simulated")
    scans = list(thinned(sequence(tmp_path / "00")))
    matrix = judge(network, scans)
    assert matrix[ROAD].sum() == 4000
    assert matrix.sum() == 4000
    assert matrix[ROAD, ROAD] == sum(
        np.count_nonzero(network.classes(scan) == ROAD) for scan, _ in scans
    )
    nothing = Scan(np.zeros((10, 3), np.float32), None, None, None, "lidar")
    assert not network.classes(nothing).any()


def test_a_training_is_of_what_was_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plans_made: list[Plan] = []

    def carry_out(plan: Plan, order: Order, console: Console) -> Path:
        plans_made.append(plan)
        return order.output

    monkeypatch.setattr(scan_training, "carry_out", carry_out)
    scans = sequence(tmp_path / "00")
    for file in (scans / "velodyne").iterdir():  # some of it farther off than 3 deviations
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        (rows * [4, 4, 4, 1]).astype("<f4").tofile(file)
    order = Order(
        data=scans, output=tmp_path / "net", steps=1, seed=0, threads=1,
        license="none", attribution="none", command="test",
    )  # fmt: skip
    choices = ScanChoices(width=0.25, sensor="semantickitti", recipe="strong", channels=4)
    scan_training.train_from_points(order, choices, QUIET)
    (plan,) = plans_made
    assert plan.shape == (4, 64, 512)
    assert plan.data == "100 % 00: 1 scans; recipe strong, normalized as semantickitti"
    (sample,) = plan.samples
    assert sample.shape == (4, 64, 512)
    # What tells the 8-bit file its ranges is cut off at 3 deviations; what is learned from is not.
    assert np.abs(sample).max() == 3.0
    learned_from = plan.task.batch(np.random.default_rng(0))["input"]
    assert learned_from.abs().max() > 3.0
    assert learned_from.shape == (4, 4, 64, 256)
