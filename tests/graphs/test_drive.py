"""The real drive through the command: whole, the same again, and right about the annotated cars."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stages.kernels.geometry import invert, rotation_exp
from stages.sinks.ply import VERTEX
from stages.sources.kitti_files import read_poses
from stages.taxonomy import load_taxonomy

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "drive.yaml"
SOURCES = ("camera", "lidar", "odometry")
FRAMES = 3
FIRST = 20  #: of the drive: both recordings hold it, with two annotated cars in view


class Layout(NamedTuple):
    """One of the two recordings of the drive."""

    folder: str
    boxes: str
    start: int  #: frame of the recording that is frame FIRST of the drive
    pose: int  #: line of the poses of that frame


LAYOUTS = (
    Layout("kitti_drive_lite108", "boxes.json", FIRST, FIRST),
    Layout("kitti_drive_full6", "annotation.json", 0, 0),
)


def drive(
    recording: Path, start: int, out: Path, speed: str = "max", frames: int = FRAMES
) -> dict[str, bytes]:
    """What the command writes of a few frames, by name."""
    words = ["run", str(GRAPH), "--speed", speed, "--quiet"]
    words += ["--out", str(out), "--report", str(out / "report.json")]
    settings = [f"parameters.recording={recording}"]
    for source in SOURCES:
        settings.append(f"stages.{source}.options.start={start}")
        settings.append(f"stages.{source}.options.stop={start + frames}")
    for setting in settings:
        words += ["--set", setting]
    command = [sys.executable, "-m", "tools.main", *words]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


def inside_cars(positions: np.ndarray, boxes: Path, map_from_lidar: np.ndarray) -> np.ndarray:
    """(n,) the position (map frame) lies in an annotated car of frame FIRST, above its tires."""
    content = json.loads(boxes.read_text())
    titles = {thing["key"]: thing["classTitle"] for thing in content["objects"]}
    frame = next(frame for frame in content["frames"] if frame["index"] == FIRST)
    local = positions @ invert(map_from_lidar)[:3, :3].T + invert(map_from_lidar)[:3, 3]
    inside = np.zeros(len(positions), dtype=np.bool_)
    for figure in frame["figures"]:
        if titles[figure["objectKey"]] != "Car":
            continue
        center, turn, size = (
            np.array([figure["geometry"][key][axis] for axis in "xyz"])
            for key in ("position", "rotation", "dimensions")
        )
        offset = (local - center) @ rotation_exp(turn)
        in_box = (np.abs(offset) < size / 2).all(axis=1)
        inside |= in_box & (offset[:, 2] > 0.25 - size[2] / 2)
    return inside


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.folder)
def test_a_drive_maps_its_cars_and_road_the_same_in_two_runs(
    layout: Layout, shared: Path, tmp_path: Path
) -> None:
    recording = shared / "data" / layout.folder
    files = drive(recording, layout.start, tmp_path / "one")
    again = drive(recording, layout.start, tmp_path / "two")
    report = json.loads(files.pop("report.json"))
    again.pop("report.json")
    stamp = f"{round(layout.start * 1e8):020d}.png"
    assert set(files) == {"map.ply", "top_view.png", f"image/{stamp}", f"cloud/{stamp}"}
    assert files == again

    assert report["ledger_balanced"]
    assert not report["failures"]
    assert {output["count"] for output in report["outputs"].values()} == {FRAMES}
    assert not any(edge["dropped"] for edge in report["edges"].values())
    assert report["stages"]["semantic_map"]["statistics"]["clouds"] == FRAMES
    counted = report["stages"]["fuse_cloud"]["statistics"]
    assert 0.12 < counted["points_with_evidence"] / counted["points"] < 0.2  # one camera ahead

    voxels = np.frombuffer(files["map.ply"].partition(b"end_header\n")[2], VERTEX)
    assert (voxels["confidence"] >= 0.8).all()
    positions = np.stack([voxels[axis] for axis in "xyz"], axis=1).astype(np.float64)
    vehicle, road = (load_taxonomy().id(name) for name in ("vehicle", "road"))
    pose = read_poses(recording / "poses_lidar_odometry.txt")[layout.pose]
    cars = inside_cars(positions, recording / layout.boxes, pose)
    assert cars.sum() > 100
    assert (voxels["class"][cars] == vehicle).mean() > 0.95

    x, y, z = ((positions - pose[:3, 3]) @ pose[:3, :3]).T
    lane = (x > 6) & (x < 20) & (np.abs(y) < 2) & (z < -1.4)
    assert lane.sum() > 500
    assert (voxels["class"][lane] == road).mean() > 0.99


@pytest.mark.slow
@pytest.mark.realtime
def test_live_every_scan_is_mapped_and_what_the_networks_could_not_take_is_said(
    shared: Path, tmp_path: Path
) -> None:
    recording = shared / "data" / "kitti_drive_lite108"
    files = drive(recording, FIRST, tmp_path, speed="1", frames=20)
    report = json.loads(files["report.json"])
    assert report["ledger_balanced"]
    assert not report["failures"]
    assert "map.ply" in files
    taken = report["edges"]["camera/out->segment_rgb/image"]
    assert taken["produced"] == 20 == taken["delivered"] + sum(taken["dropped"].values())
    assert set(taken["dropped"]) <= {"replaced"}
    scans = report["edges"]["lidar/out->fuse_cloud/cloud"]
    assert scans["delivered"] + scans["dropped"].get("replaced", 0) == 20
    # How many it takes depends on the machine.
    assert report["outputs"]["semantic_map/out"]["count"] == scans["delivered"] > 0
