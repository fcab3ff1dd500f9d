"""After a disaster: ruins, rubble, persons who lie, dust."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.buildings import FLOOR_M
from stages.simulation.district import build_district
from stages.simulation.persons import PARTS, Build, limbs, lying
from stages.simulation.ruins import rubble, ruin
from stages.simulation.simulation import Exposure, Simulation
from stages.simulation.specification import Preset, load_preset
from stages.taxonomy import load_taxonomy
from stages.types import Image

BUILDING, HEAP = 1, 2


def test_a_ruin_stands_on_one_side_and_is_rubble_on_the_other() -> None:
    for seed in range(4):
        mesh = ruin(BUILDING, HEAP, np.random.default_rng(seed), 12.0, 10.0, 3)
        things = np.array(mesh.things)[np.concatenate(mesh.surface_of)]
        corners = np.concatenate(mesh.corners)
        walls = corners[things == BUILDING].reshape(-1, 3)
        full = 0.5 + 3 * FLOOR_M
        assert walls[:, 2].max() == pytest.approx(full, abs=0.01)
        # At one of the two corners of the front nothing stands higher than a person.
        tops = [
            walls[np.hypot(*(walls[:, :2] - at).T) < 1.2, 2].max() for at in ([-6, -5], [6, -5])
        ]
        assert min(tops) < 0.45 * full
        heap = corners[things == HEAP].reshape(-1, 3)
        assert 0.8 < heap[:, 2].max() < 0.6 * full
        assert heap[:, 1].min() < -5.0  # some of it lies before the house


def test_a_heap_lies_on_the_ground_within_its_radius() -> None:
    points = np.concatenate(
        rubble(HEAP, np.random.default_rng(1), 2.0, 1.0).corners
    ).reshape(-1, 3)  # fmt: skip
    assert points[:, 2].max() == pytest.approx(1.0, abs=0.5)
    assert points[:, 2].min() > -1.0  # pieces are stuck into it
    assert np.hypot(points[:, 0], points[:, 1]).max() < 3.6


def test_a_person_who_lies_is_as_long_as_one_who_stands_and_flat() -> None:
    random = np.random.default_rng(3)
    build = Build.draw(random)
    poses = lying(build, random)
    assert len(poses) == PARTS
    points = np.concatenate(
        [
            np.concatenate(part.corners).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
            for part, pose in zip(limbs(1, build), poses, strict=True)
        ]
    )
    assert np.ptp(points[:, 0]) == pytest.approx(build.height_m, abs=0.25)
    assert -0.15 < points[:, 2].min() < 0.1
    assert points[:, 2].max() < 0.7


def test_a_disaster_site_has_ruins_rubble_and_persons_where_a_district_has_houses() -> None:
    sites = [
        build_district(6, 10.0, 2.6, (4.5, 7.5), "aircraft", site)
        for site in ("district", "disaster")
    ]
    names = load_taxonomy().names
    counts = [
        {name: int((one.classes == k).sum()) for k, name in enumerate(names)} for one in sites
    ]
    assert counts[1]["building"] > 50
    assert counts[1]["person"] >= 10
    # Heaps are things of their own, and the same route is flown.
    assert counts[1]["object"] != counts[0]["object"]
    assert len(sites[0].flight.stamps) == len(sites[1].flight.stamps)


@pytest.mark.slow
def test_dust_lightens_what_is_far_and_leaves_what_is_near(tiny: Simulation) -> None:
    dusty = tiny.preset.model_copy(update={"visibility_m": 100.0})
    other = Simulation(dusty, load_preset("tiny")[1])
    turn = Exposure("rgb", 1, 200_000_000, 200_000_000)
    images, depth = [], None
    for simulation in (tiny, other):
        for sample in simulation.take(turn):
            if isinstance(sample.message.payload, Image):
                images.append(sample.message.payload.data.astype(int))
            elif sample.topic == "rgb/depth":
                depth = sample.message.payload.depth * sample.message.payload.unit_m
    assert depth is not None
    change = np.abs(images[1] - images[0]).mean(axis=2)
    near, far = (depth > 0) & (depth < 6), (depth > 14)
    assert near.any()
    assert far.any()
    assert change[far].mean() > change[near].mean() + 5


def test_a_preset_says_its_site() -> None:
    preset, _ = load_preset("disaster")
    assert (preset.site, preset.visibility_m) == ("disaster", 350.0)
    with pytest.raises(ValueError, match="district"):
        Preset.model_validate(preset.model_dump() | {"site": "ruin"})
