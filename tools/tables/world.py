"""The simulated world of the tables: flights, what cameras said of them, and what is true."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.console import Console

from pipeline.errors import DataError
from stages.frames import look, mounted
from stages.kernels.compiled import as_input
from stages.kernels.geometry import has_return
from stages.labels import LabeledVoxels
from stages.observed import Observation, read_observation
from stages.sinks.whole_file import whole_file
from stages.sources.recording import Recording, calibration
from stages.types import Scan
from tools.propagation.observing import Order, observe
from tools.propagation.survey import Truth
from tools.simulate import simulate_file
from tools.tables.plan import Flights, Scale, plans

#: Nearer returns are the vehicle itself: its far rotor turns 1.4 m from the LiDAR.
MIN_RANGE_M = 1.5
#: Of the maps, and of the true one.
VOXEL_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class JudgedScan:
    """A scan of a flight with everything a row may want of it."""

    observation: Observation
    truth: NDArray[np.uint8]  #: (n,) classes, 0 without a return
    visible: NDArray[np.bool_]  #: (n,) in the image of a color camera, hidden or not
    things: NDArray[np.uint16]  #: (n,) which thing of the simulation it is, 0 without a return

    @property
    def scan(self) -> Scan:
        """As a network takes it."""
        one = self.observation
        return Scan(one.points, one.remission, None, one.shape, one.sensor)


class World:
    """Flights below a folder, made when they are first asked for."""

    def __init__(self, folder: Path, scale: Scale, console: Console) -> None:
        self.folder = folder
        self.scale = scale
        self._console = console

    def flights(self, name: str) -> list[Path]:
        """The files of the scale's flights of that name, or of a figure's. Raises DataError."""
        extra = plans().flights
        if name in extra:
            flights = extra[name].of(self.scale.flight_a)
        else:
            flights = getattr(self.scale, name)
        return [self._flight(name, flights, seed) for seed in flights.seeds]

    def observed(self, name: str) -> list[Path]:
        """The observations of a flight of the vehicle: the networks run once."""
        (flight,) = self.flights(name)
        settings: tuple[str, ...] = ()
        if (part := self.scale.flight_a.preset.get("scale", 1.0)) < 1.0:
            pitch = 90 / (128 * part)
            settings = tuple(
                f"stages.{stage}.options.vertical_pitch_deg={pitch:.3f}"
                for stage in ("camera_cloud", "fused_cloud")
            )
        order = Order.of(flight, None, settings=settings)
        files, _ = observe(order, self.folder / name, self._console)
        return files

    def judged(self, name: str) -> Iterator[JudgedScan]:
        """The scans of a flight of the vehicle with truth and view. Raises DataError."""
        (flight,) = self.flights(name)
        sensors, truths = calibration(path=flight), Truth(flight)
        cameras = [camera for camera in sensors.cameras() if camera.startswith("rgb")]
        for file in self.observed(name):
            observation = read_observation(file)
            truth = truths.labels_of(observation)
            if truth is None:
                raise DataError(f"{flight}: says nothing true of the scan at {observation.stamp}")
            returns = has_return(as_input(observation.points), MIN_RANGE_M)
            visible = np.zeros(len(returns), dtype=np.bool_)
            for camera in cameras:
                chain = mounted(sensors, camera, observation.sensor)
                seen = look(sensors.camera(camera), observation.points, returns, chain)
                visible[seen.index] = True
            classes = np.where(returns, truth.classes.ravel(), 0).astype(np.uint8)
            things = np.where(returns, truth.instances.ravel(), 0).astype(np.uint16)
            yield JudgedScan(observation, classes, visible, things)

    def true_map(self, name: str) -> LabeledVoxels:
        """The classes of the voxels that surfaces pass through."""
        (flight,) = self.flights(name)
        source = Recording(path=flight, topic="truth/map")
        source.open()
        for message in source.messages():
            if isinstance(message.payload, LabeledVoxels):
                return message.payload
        raise DataError(f"{flight}: holds no true map")

    def preset_of(self, name: str) -> Path:
        """The preset that the only flight of that name was simulated from."""
        (flight,) = self.flights(name)
        return self._preset(flight.stem)

    def _preset(self, stem: str) -> Path:
        return self.folder / "presets" / f"{stem}.yaml"

    def _flight(self, name: str, flights: Flights, seed: int) -> Path:
        preset = self._preset(f"{name}-{seed}")
        with whole_file(preset) as file:
            file.write(yaml.safe_dump(flights.preset | {"seed": seed}).encode())
        flight = self.folder / name / f"{name}-{seed}.mcap"
        if not flight.exists():
            self._console.print(f"simulating {flight.name} ...", highlight=False)
            simulate_file(str(preset), flight, jobs=None, as_json=False)
        return flight
