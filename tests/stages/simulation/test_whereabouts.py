"""Where things are agrees with where the sensors see them."""

from __future__ import annotations

import numpy as np
import pytest

from stages.labels import Labels
from stages.simulation.simulation import Sample, Simulation
from stages.simulation.whereabouts import Whereabouts
from stages.taxonomy import load_taxonomy
from stages.types import Scan


@pytest.mark.slow
def test_the_returns_of_a_thing_lie_around_its_middle(
    tiny: Simulation, samples: list[Sample]
) -> None:
    (scan,) = [s.message for s in samples if s.topic == "lidar"][:1]
    (truth,) = [s.message.payload for s in samples if s.topic == "truth/lidar"][:1]
    assert isinstance(scan.payload, Scan)
    assert isinstance(truth, Labels)
    pose = tiny.district.flight.at(np.array([scan.stamp]))[0]
    pose = pose @ tiny.rig.calibration().sensor("lidar").base_from_sensor
    points = scan.payload.points @ pose[:3, :3].T + pose[:3, 3]
    middles = Whereabouts(tiny.district).at(scan.stamp)
    things, classes = truth.instances.ravel(), truth.classes.ravel()
    persons = np.unique(things[classes == load_taxonomy().id("person")])
    assert len(persons) >= 3
    for person in persons:
        # A person's arms and legs reach less far than this; it walks on during the sweep.
        off = np.linalg.norm(points[things == person] - middles[person], axis=1)
        assert off.max() < 1.5


def test_what_has_no_surface_is_nowhere(tiny: Simulation) -> None:
    middles = Whereabouts(tiny.district).at(0)
    assert np.isnan(middles[0]).all()  # the sky
    assert len(middles) == len(tiny.district.classes)
