"""The networks of the simulated tables: each trained once per seed from its mixture, then kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console

from stages.kernels.compiled import as_input
from stages.kernels.geometry import has_return
from stages.observed import read_observation, write_observation
from stages.scan_statistics import ScanStatistics
from stages.sinks.whole_file import whole_file
from tools.propagation.observing import FOLDER, NOTE, Order
from tools.propagation.propagate import Product, propagate
from tools.propagation.settings import Settings, Teacher
from tools.tables.evidence import fused_evidence, with_fused
from tools.tables.plan import NetworkPlan, plans
from tools.tables.scan_judging import ScanNetwork
from tools.tables.world import MIN_RANGE_M, World
from tools.train.open_scans import open_scans
from tools.train.plan import Order as Training
from tools.train.scan_sources import LabeledPoints, ScanSource
from tools.train.scan_training import ScanChoices, train_from_points

#: Of the target's sensor: the image of all networks.
ELEVATION_RAD = (-np.pi / 4, np.pi / 4)
#: Scans that tell the figures of a source.
MEASURED = 40
SOURCE, ADAPTED, HEIGHT, VIEWS = "source", "adapted", "height", "views"
#: What labels a further iteration: the fused map of a flight with this network in it, by part.
RETRAINED = "views-map"
AGAIN = {"again": "flight_a", "again-disaster": "disaster"}


def needs(name: str) -> set[str]:
    """The networks that must be there before one of `paper.yaml` can be trained."""
    network = plans().networks[name]
    found = {network.start} if network.start is not None else set()
    if Teacher.FUSED_MAP in network.parts:
        found.add(SOURCE)
    if AGAIN.keys() & network.parts.keys():
        found.add(RETRAINED)
    return found


class Networks:
    """Trains what a row asks for; what is there already is opened."""

    def __init__(self, world: World, steps: int, threads: int, console: Console) -> None:
        self._world = world
        self._steps = steps
        self._threads = threads
        self._console = console

    def open(self, name: str, seed: int, size: int, normal: str) -> ScanNetwork:
        """The network of `paper.yaml` at an image `size` columns wide, normalized as `source`,
        `adapted` or `height` (z alone adapted). Raises OverflightError, Interrupted."""
        registry = self.trained(name, seed)
        model = "segment-scan" if size == 512 else f"segment-scan-{size}"
        return ScanNetwork.open(registry, normal, self._statistics(), name=model)

    @property
    def there(self) -> set[tuple[str, int]]:
        """The name and seed of each network that is trained."""
        found = (file.parent.name for file in (self._world.folder / "networks").glob("*/done"))
        return {(name, int(seed)) for name, _, seed in (one.rpartition("-") for one in found)}

    def prepare(self, name: str, seed: int) -> None:
        """Make what a network learns from: flights, views, labels, and so the networks in them."""
        self._statistics()
        self._mixture(name, plans().networks[name], seed)

    def trained(self, name: str, seed: int) -> Path:
        """The registry of the network, trained where it is not there. Raises OverflightError,
        `tools.train.loop.Interrupted`."""
        network = plans().networks[name]
        folder = self._world.folder / "networks" / f"{name}-{seed}"
        if (folder / "done").is_file():
            return folder / "models.yaml"
        start = None
        if network.start is not None:
            start = self.trained(network.start, seed).parent
        training = Training(
            data=self._mixture(name, network, seed),
            output=folder,
            steps=self._steps,
            seed=seed,
            threads=self._threads,
            license="Apache-2.0",
            attribution="simulated flights of Overflight",
            command="overflight evaluate --table",
            start=start,
            gathered=self._world.scale.batch // 4,
            quantized=False,
        )
        choices = ScanChoices(
            width=self._world.scale.width,
            sensor=ADAPTED,
            statistics=self._statistics(),
            recipe=network.recipe,
            channels=network.channels,
            sizes=((64, 512), (128, 1024)),
        )
        self._console.print(f"training {name}, seed {seed} ...", highlight=False)
        registry = train_from_points(training, choices, self._console)
        with whole_file(folder / "done") as file:
            file.write(b"")
        return registry

    def _mixture(self, name: str, network: NetworkPlan, seed: int) -> Path:
        """The YAML file that the network's parts make up."""
        sources = []
        for part, share in network.parts.items():
            places = self._places(part, seed)
            for place in places:
                entry: dict[str, object] = {"path": str(place), "share": share / len(places)}
                entry["sensor"] = {"source": SOURCE, "views": VIEWS}.get(part, ADAPTED)
                if part == "unlabeled":
                    entry["labels"] = False
                sources.append(entry)
        path = self._world.folder / "mixtures" / f"{name}-{seed}.yaml"
        with whole_file(path) as file:
            file.write(yaml.safe_dump({"sources": sources}, sort_keys=False).encode())
        return path

    def _places(self, part: str, seed: int) -> list[Path]:
        if part == "source":
            return [one.resolve() for one in self._world.flights("source")]
        if part == "views":
            return [self._views(one) for one in self._world.flights("views")]
        if part == Teacher.FUSED_MAP:
            return [self._fused_labels(part, "flight_a", SOURCE, seed)]
        if part in AGAIN:
            return [self._fused_labels(part, AGAIN[part], RETRAINED, seed)]
        teacher = Teacher.OVERLAY if part == Teacher.OVERLAY else Teacher.CAMERA_MAP
        observed = self._world.folder / "flight_a"
        folder = self._world.folder / f"labels-{teacher.value}"
        return [self._labeled("flight_a", teacher, observed, folder)]

    def _views(self, flight: Path) -> Path:
        """The views over a driven street, as a sequence: `views_of_flight` in files."""
        from tools.tables.views import write_views

        folder = flight.with_suffix(".views")
        if not (folder / "poses.txt").is_file():
            write_views(flight, folder)
        return folder.resolve()

    def _fused_labels(self, part: str, flight: str, network: str, seed: int) -> Path:
        """A flight with the labels of its fused map, which has this seed's network in it."""
        folder = self._world.folder / f"labels-{part}-{seed}"
        observed = self._observed_with(flight, network, seed, folder)
        return self._labeled(flight, Teacher.FUSED_MAP, observed, folder)

    def _labeled(self, flight: str, teacher: Teacher, observed: Path, folder: Path) -> Path:
        """A flight, labeled by a teacher of its observations."""
        self._world.observed(flight)
        if not (folder / "report.json").is_file():
            (file,) = self._world.flights(flight)
            note = yaml.safe_load((observed / NOTE).read_text())
            order = replace(Order.of(file, None), settings=tuple(note["settings"]))
            product = Product(folder, label_set=None, observed=observed, surveyed=False)
            propagate(order, Settings(teacher=teacher), product, self._console)
        return folder.resolve()

    def _observed_with(self, flight: str, name: str, seed: int, folder: Path) -> Path:
        """The observations of a flight with a network's evidence in the fused one."""
        made = folder / NOTE
        if made.is_file():
            return folder
        network = self.open(name, seed, 512, ADAPTED)
        for file in self._world.observed(flight):
            observation = read_observation(file)
            both = fused_evidence(observation, network, cameras=True)
            write_observation(folder / FOLDER / file.name, with_fused(observation, both))
        with whole_file(made) as target:
            target.write((self._world.folder / flight / NOTE).read_bytes())
        return folder

    def _statistics(self) -> Path:
        """The figures of the source, and those adapted to flight A (in z alone too) and to the
        views: meters count alike in all."""
        path = self._world.folder / "statistics.yaml"
        if path.is_file():
            return path
        source = _measured(open_scans(one) for one in self._world.flights("source"))
        views = _measured(open_scans(self._views(one)) for one in self._world.flights("views"))
        target = _measured(iter([_Observed(self._world.observed("flight_a"))]))
        fitted = {
            SOURCE: source,
            ADAPTED: source.adapted_to(target),
            HEIGHT: source.adapted_to(target, remission=False),
            VIEWS: source.adapted_to(views),
        }
        text = ""
        for name, entry in fitted.items():
            text = entry.written_to(text, name, "the simulated flights beside this file")
        with whole_file(path) as file:
            file.write(text.encode())
        return path


class _Observed:
    """Observations as a source of scans without labels."""

    told = "observations"

    def __init__(self, files: list[Path]) -> None:
        self._files = files

    def __len__(self) -> int:
        return len(self._files)

    def read(self, number: int) -> LabeledPoints:
        one = read_observation(self._files[number])
        nothing = np.zeros(len(one.points), dtype=np.float32)
        remission = nothing if one.remission is None else one.remission
        return LabeledPoints(one.points, remission, nothing.astype(np.uint8), one.shape)


def _measured(sources: Iterator[ScanSource]) -> ScanStatistics:
    """Mean and deviation of range, x, y, z and remission over the returns of some scans."""
    rows = []
    for source in sources:
        for number in np.linspace(0, len(source) - 1, min(MEASURED, len(source))).astype(int):
            one = source.read(int(number))
            hit = has_return(as_input(one.points), MIN_RANGE_M)
            points = one.points[hit]
            distance = np.linalg.norm(points, axis=1)
            rows.append(np.column_stack([distance, points, one.remission[hit]]))
    every = np.concatenate(rows).astype(np.float64)
    mean, std = every.mean(axis=0), np.maximum(every.std(axis=0), 1e-3)
    return ScanStatistics(ELEVATION_RAD, mean.astype(np.float32), std.astype(np.float32))
