"""The simulated tables' plan, and how a row is judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from judged_scans import BUILDING, PERSON, ROAD, VEHICLE, Network, judged, row

from stages.labels import LabeledVoxels
from stages.simulation.specification import Preset
from tools.tables.evidence import classes_of, fused_evidence, with_fused
from tools.tables.networks import AGAIN
from tools.tables.plan import plans, scale_named
from tools.tables.simulated import judge_map, judge_scans
from tools.tables.world import JudgedScan
from tools.train.scan_recipes import RECIPES


class World:
    """One scan in place of flights."""

    def __init__(self, scan: JudgedScan) -> None:
        self.scan = scan

    def judged(self, _: str) -> Iterator[JudgedScan]:
        yield self.scan

    def true_map(self, _: str) -> LabeledVoxels:
        indices = np.floor(self.scan.observation.points / 0.25).astype(np.int32)
        beyond = np.array([[4000, 0, 0]], np.int32)  # no return ever hit it
        classes = np.append(self.scan.truth, BUILDING).astype(np.uint8)
        return LabeledVoxels(0.25, np.concatenate([indices, beyond]), classes)


SCAN = judged([ROAD, ROAD, VEHICLE, PERSON, PERSON], [0, 1, 2, 3], {0: ROAD, 1: ROAD, 2: VEHICLE})


def test_the_tables_have_the_papers_rows_and_controls() -> None:
    tables = plans().tables
    assert {name: len(table.rows) for name, table in tables.items()} == {
        "3": 9, "4": 6, "5": 14, "6": 4, "second": 3, "12": 5, "17": 4,
    }  # fmt: skip
    controls = {k: sum(row.mean is None for row in tables[k].rows.values()) for k in "3456"}
    assert controls == {"3": 1, "4": 0, "5": 3, "6": 0}


def test_rows_alike_in_two_tables_are_judged_once_and_others_apart() -> None:
    tables = plans().tables
    before, source = tables["3"].rows["single-512"], tables["5"].rows["source-i"]
    assert before.judged == source.judged == "source-512-adapted-view-all"
    for name in ("3", "4", "5", "6", "12", "17"):
        rows = tables[name].rows.values()
        assert len({one.judged for one in rows}) == len(rows)
    cameras = [
        tables["3"].rows["image-view"],
        *(tables["6"].rows[f"map-camera{v}"] for v in ("", "-view")),
    ]
    assert [one.judged for one in cameras] == [
        "cameras-view-camera", "cameras-map-view-all", "cameras-map-view-camera",
    ]  # fmt: skip


def test_a_flight_of_a_figure_is_flight_a_changed() -> None:
    scale = scale_named("quick")
    long, site = (plans().flights[name].of(scale.flight_a) for name in ("long", "disaster"))
    length = scale.flight_a.preset["duration_s"]
    assert (long.preset["duration_s"], site.preset["duration_s"]) == (4 * length, length)
    assert site.preset["site"] == "disaster"
    assert site.preset["rig"] == scale.flight_a.preset["rig"]
    assert "site" not in scale.flight_a.preset
    for one in (long, site):
        Preset.model_validate(one.preset | {"seed": one.seeds[0]})


def test_every_row_names_a_network_and_every_network_known_parts() -> None:
    networks = plans().networks
    for table in plans().tables.values():
        for one in table.rows.values():
            assert one.network is None or one.network in networks
    parts = {"source", "views", "map", "overlay", "fused", "unlabeled", *AGAIN}
    for name, network in networks.items():
        assert set(network.parts) <= parts
        assert network.recipe in RECIPES
        # What is compared has begun alike: with the source network, of as many channels or more.
        assert network.start == (None if name in ("source", "source-shape") else "source")
        assert network.channels <= networks["source"].channels
    for name in ("full", "quick"):
        assert scale_named(name).steps > 0


def test_evidence_is_the_networks_times_the_cameras() -> None:
    network = Network([VEHICLE, VEHICLE, VEHICLE, PERSON, PERSON])
    alone = fused_evidence(SCAN.observation, network, cameras=False)  # type: ignore[arg-type]
    assert classes_of(alone).tolist() == [VEHICLE, VEHICLE, VEHICLE, PERSON, 0]
    both = fused_evidence(SCAN.observation, network, cameras=True)  # type: ignore[arg-type]
    assert classes_of(both).tolist() == [ROAD, ROAD, VEHICLE, PERSON, 0]  # surer than the network
    cameras = fused_evidence(SCAN.observation, None, cameras=True)
    assert classes_of(cameras).tolist() == [ROAD, ROAD, VEHICLE, 0, 0]
    kept = with_fused(SCAN.observation, both)
    assert kept.fused is not None
    assert kept.fused.index.tolist() == [0, 1, 2, 3]


def test_of_the_vehicle_itself_nothing_is_said() -> None:
    scan = judged([0, VEHICLE], [0], {0: PERSON})
    scan.observation.points[0] = [1.0, 0.9, 0.0]  # a rotor
    for network in (Network([PERSON, VEHICLE]), None):
        cloud = fused_evidence(scan.observation, network, cameras=True)  # type: ignore[arg-type]
        assert not cloud.evidence[0]


def test_background_is_never_said() -> None:
    network = Network([0, 0, 0, 0, 0], sure=9.0)
    cloud = fused_evidence(SCAN.observation, network, cameras=False)  # type: ignore[arg-type]
    assert 0 not in classes_of(cloud)[:4]


def test_a_row_in_the_cameras_view_leaves_the_rest_out() -> None:
    network = Network([ROAD, ROAD, VEHICLE, ROAD, PERSON])
    whole = judge_scans(World(SCAN), row(network="source"), network, "flight_a")  # type: ignore[arg-type]
    assert whole.points == {
        "building": 0, "road": 2, "vegetation": 0, "person": 2, "bike": 0, "car": 1, "object": 0,
    }  # fmt: skip
    assert whole.classes["person"] == 0
    assert whole.facts["person_points_out_of_view"] == 1
    assert whole.facts["person_recall_out_of_view"] == 0
    part = judge_scans(
        World(SCAN),
        row(network="source", view="camera"),
        network,
        "flight_a",  # type: ignore[arg-type]
    )
    assert part.points["person"] == 1
    assert "person_recall_out_of_view" not in part.facts


def test_what_the_images_say_nothing_of_is_no_part_of_their_row() -> None:
    verdict = judge_scans(World(SCAN), row(view="camera"), None, "flight_a")  # type: ignore[arg-type]
    assert verdict.points["person"] == 0
    assert verdict.mean == pytest.approx(100)


@pytest.mark.parametrize(("view", "person"), [("all", 2), ("camera", 0)])
def test_a_voxel_that_a_map_lacks_is_a_miss_unless_the_view_is_the_cameras(
    view: str, person: int
) -> None:
    verdict = judge_map(World(SCAN), row(map=True, view=view), None, "flight_a")  # type: ignore[arg-type]
    assert verdict.points["person"] == person
    assert verdict.points["road"] == 2
    assert verdict.points["building"] == 0  # nobody could have seen it
    assert verdict.classes["road"] == 100


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--table", "7"], "'7' is not one of '3', '4', '5', '6', 'second', 'real'"),
        (["a.ply", "--table", "3"], "judges no PREDICTION"),
        ([], "give a PREDICTION to be judged, or a --table to be made"),
        (["--table", "real", "--shared", "."], "is not there; this table needs it (--shared)"),
    ],
)
def test_a_mistake_is_said_in_a_line(
    words: list[str], said: str, overflight: Callable[..., object]
) -> None:
    answer = overflight("evaluate", *words)
    assert answer.code == 2
    assert said in " ".join(answer.err.replace("│", " ").split())
