"""`overflight propagate` as a user runs it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from tiny_street import ROAD, VEHICLE, observation, world, written

from stages.sources.kitti_layouts import open_drive
from tools.propagation.observing import FOLDER, NOTE, Order
from tools.propagation.propagate import Product, propagate
from tools.propagation.settings import Settings, Teacher

SILENT = Console(stderr=True, quiet=True)


@pytest.fixture
def observed(tmp_path: Path) -> tuple[Order, Path]:
    """An order whose observations are there already, and where."""
    recording = tmp_path / "drive"
    recording.mkdir()
    output = tmp_path / "labels"
    _, true = world()
    fused = np.where(true == ROAD, VEHICLE, true)
    written(
        output / FOLDER,
        [observation(k, x, fused=fused) for k, x in enumerate([-10.0, -5, 0, 4])],
    )
    order = Order.of(recording, None)
    (output / NOTE).write_text(json.dumps(order.note()))
    return order, output


def test_labels_are_a_sequence_that_semantickitti_tools_read(observed: tuple[Order, Path]) -> None:
    order, output = observed
    report = propagate(order, Settings(), Product(output), SILENT)
    drive = open_drive(output)
    points, true = world()
    assert sorted(drive.scans) == [0, 1, 2, 3]
    read, remission = drive.read_scan(drive.scans[2])
    labels = np.fromfile(output / "labels/000002.label", "<u4")
    assert len(read) == len(labels) == len(points)
    assert set(labels) <= {0, 40, 50}  # SemanticKITTI's road and building
    assert (labels[true == ROAD] != 50).all()
    assert set(remission) == {0.5}
    poses = drive.read_poses()
    np.testing.assert_allclose(poses[:, :3, 3], [[x, 0, 1.5] for x in (-10, -5, 0, 4)])
    assert report["labels"]["labeled_share"] > 0.9
    assert report["observed_before"]


def test_the_report_says_who_labels_how_much(observed: tuple[Order, Path]) -> None:
    order, output = observed
    report = propagate(order, Settings(), Product(output, pictures=2), SILENT)
    shares = {name: told["labeled_share"] for name, told in report["teachers"].items()}
    assert shares["overlay"] < 0.4 < shares["map"]
    assert report["teachers"]["fused"]["classes"].get("road", 0) == 0
    stored = json.loads((output / "report.json").read_text())
    assert stored["teachers"] == report["teachers"]
    for name in report["panels"]:
        picture = cv2.imread(str(output / name))
        assert picture.shape[1] > 1024
    assert len(report["panels"]) == 2
    assert "panels/" in (output / "report.html").read_text()


def test_other_options_use_the_same_observations(observed: tuple[Order, Path]) -> None:
    order, output = observed
    before = propagate(order, Settings(), Product(output), SILENT)
    after = propagate(order, Settings(teacher=Teacher.OVERLAY), Product(output), SILENT)
    assert after["labels"]["labeled_share"] < before["labels"]["labeled_share"]


def test_own_ids_and_labels_alone(observed: tuple[Order, Path]) -> None:
    order, output = observed
    propagate(order, Settings(), Product(output, label_set=None, scans=False), SILENT)
    assert set(np.fromfile(output / "labels/000002.label", "<u4")) <= {0, 1, 3}
    assert not list(output.glob("velodyne/*"))


def test_the_same_recording_gives_the_same_bytes(observed: tuple[Order, Path]) -> None:
    order, output = observed
    propagate(order, Settings(dynamic_window=1), Product(output), SILENT)
    first = {f.name: f.read_bytes() for f in (output / "labels").iterdir()}
    propagate(order, Settings(dynamic_window=1), Product(output), SILENT)
    assert first == {f.name: f.read_bytes() for f in (output / "labels").iterdir()}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.mcap"], "nowhere.mcap: no such file or folder"),
        ([".", "--dynamic-window", "1", "--dynamic-within", "1"], "take one of"),
        ([".", "--from", "overlay", "--dynamic-within", "1"], "no window"),
        ([".", "--label-set", "semantikitti"], "did you mean 'semantickitti'"),
        (["."], "no drive found"),
    ],
)
def test_a_mistake_is_said_in_a_line(
    words: list[str], said: str, overflight: Callable[..., object]
) -> None:
    answer = overflight("propagate", *words)
    assert answer.code == 2
    assert said in " ".join(answer.err.replace("│", " ").split())


@pytest.mark.slow
def test_a_simulated_flight_is_labeled_from_its_true_images(
    overflight: Callable[..., object], root: Path, tmp_path: Path
) -> None:
    assert overflight("simulate", "tiny", "-o", "tiny.mcap").code == 0
    words = ["propagate", "tiny.mcap", "--graph", root / "graphs/label_propagation_truth.yaml"]
    answer = overflight(*words, "-o", "labels", "--json")
    assert answer.code == 0, answer.err
    report = json.loads(answer.out)
    assert report["scans"] == report["labeled_scans"] > 0
    assert report["teachers"]["map"]["right_share"] > 0.9
    assert (
        report["teachers"]["map"]["labeled_share"] > report["teachers"]["overlay"]["labeled_share"]
    )
    assert not report["observed_before"]


def test_a_graph_or_an_include_of_it_that_changed_observes_anew(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text("stages: {}")
    (tmp_path / "graph.yaml").write_text("include: [part.yaml]")
    first = Order(tmp_path, tmp_path / "graph.yaml").note()
    assert Order(tmp_path, tmp_path / "graph.yaml").note() == first
    (tmp_path / "part.yaml").write_text("stages: {a: {}}")
    assert Order(tmp_path, tmp_path / "graph.yaml").note() != first
