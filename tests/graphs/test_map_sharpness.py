"""The map of a real drive is sharp because of its poses, and its parked cars are single blobs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stages.kernels.geometry import rotation_exp
from stages.kernels.neighbors import blobs
from stages.kernels.sharpness import LEAST_BLOB, Sharpness, sharpness
from stages.labeled_files import LabeledMap, LabelSet, read_map
from stages.sources.kitti_files import read_poses
from stages.taxonomy import load_taxonomy

ROOT = Path(__file__).resolve().parents[2]
FIRST, LAST = 20, 31  #: a dozen frames past a row of parked cars
VEHICLE = load_taxonomy().id("vehicle")

#: Where cars are parked along the curb in these frames, in the map: lowest and highest x y, m. The
#: images show four of them, two of which are annotated.
CURB = np.array([[38.0, 3.0], [62.0, 9.0]])
PARKED = 4

SHIFTED = """\
from collections.abc import Iterator
import numpy as np
from pipeline.message import Message
from stages.sources.kitti import KittiPoses
from stages.types import Pose

class ShiftedPoses(KittiPoses):
    '''Each pose shifted by 0.3 m on the ground, in a direction of its own.'''

    def messages(self) -> Iterator[Message[Pose]]:
        rng = np.random.default_rng(0)
        for message in super().messages():
            angle = rng.uniform(0, 2 * np.pi)
            pose = message.payload.map_from_base.copy()
            pose[:2, 3] += 0.3 * np.cos(angle), 0.3 * np.sin(angle)
            yield Message.at(message.stamp, Pose(pose), received=message.received)
"""

#: A second fusion and map beside the first, from the same networks, with the shifted poses.
OVERLAY = """\
overflight: 1
graph: drive
stages:
  odometry_shifted: {use: my_poses:ShiftedPoses, options: {path: $recording}}
  fuse_shifted:
    use: stages.fuse_cloud:FuseCloud
    options: {occlusion_deg: 1.0, vertical_pitch_deg: 1.0}
    inputs:
      cloud:      lidar
      scores:     {from: segment_rgb, sync: nearest, tolerance_ms: 2000, max_wait_ms: 150}
      boxes:      {from: detect_rgb, sync: nearest, tolerance_ms: 70, max_wait_ms: 150}
      trajectory: {from: odometry_shifted, sync: span}
  map_shifted:
    use: stages.semantic_map:SemanticMap
    options: {voxel_m: $voxel_m}
    inputs: {cloud: {from: fuse_shifted, queue: {policy: block, size: 2}}}
  file_shifted:
    use: stages.sinks.ply:WritePly
    options: {path: $out/shifted.ply, min_confidence: $min_confidence}
    inputs: {map: map_shifted}
"""


class Maps(NamedTuple):
    """The map by the drive's poses, and by the shifted ones."""

    right: LabeledMap
    shifted: LabeledMap


@pytest.fixture(scope="module")
def maps(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Maps:
    folder = tmp_path_factory.mktemp("sharpness")
    (folder / "my_poses.py").write_text(SHIFTED)
    (folder / "overlay.yaml").write_text(OVERLAY)
    words = ["run", str(ROOT / "graphs/drive.yaml"), "--overlay", "overlay.yaml", "--quiet"]
    words += ["--speed", "max", "--out", "out"]
    words += ["--set", f"parameters.recording={shared / 'data/kitti_drive_lite108'}"]
    for source in ("camera", "lidar", "odometry", "odometry_shifted"):
        words += ["--set", f"stages.{source}.options.start={FIRST}"]
        words += ["--set", f"stages.{source}.options.stop={LAST + 1}"]
    answer = subprocess.run(
        [sys.executable, "-m", "tools.main", *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    files = (folder / "out/map.ply", folder / "out/shifted.ply")
    return Maps(*(read_map(file, LabelSet()) for file in files))


def measured(voxels: LabeledMap) -> tuple[Sharpness, dict[int, Sharpness]]:
    assert voxels.voxel_m is not None
    return sharpness(voxels.points, voxels.labels, voxels.entropy, voxels.voxel_m)


@pytest.mark.slow
def test_the_map_is_sharper_than_with_poses_shifted_by_0_3_m(maps: Maps) -> None:
    (right, by_class), (shifted, shifted_by_class) = map(measured, maps)
    assert right.thickness_m < 0.65 * shifted.thickness_m
    for name in ("building", "vehicle"):
        label = load_taxonomy().id(name)
        ratio = by_class[label].thickness_m / shifted_by_class[label].thickness_m
        assert ratio < 0.7, f"{name}: {ratio}"
    assert right.voxels < 0.9 * shifted.voxels, "the same points, smeared over more voxels"


@pytest.mark.slow
def test_parked_cars_are_single_blobs(maps: Maps, shared: Path) -> None:
    voxels = maps.right
    places = voxels.points[voxels.labels == VEHICLE]
    group = blobs(np.floor(places / voxels.voxel_m).astype(np.int64))
    large = [places[group == k] for k in range(group.max() + 1)]
    large = [blob for blob in large if len(blob) >= LEAST_BLOB]
    middles = np.array([blob[:, :2].mean(axis=0) for blob in large])
    parked = ((middles > CURB[0]) & (middles < CURB[1])).all(axis=1)
    assert parked.sum() == PARKED
    for center, axes, size in annotated_cars(shared / "data/kitti_drive_lite108"):
        offsets = [(blob - center) @ axes for blob in large]
        inside = [(np.abs(offset) < size / 2 + 0.25).all(axis=1) for offset in offsets]
        assert sum(bool(points.any()) for points in inside) == 1, "one blob, and not pieces"
        (own,) = (points for points in inside if points.any())
        assert own.mean() > 0.9, "of this car alone"


def annotated_cars(recording: Path) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Center and axes (map frame) and size of the annotated cars at the curb."""
    content = json.loads((recording / "boxes.json").read_text())
    map_from_lidar = read_poses(recording / "poses_lidar_odometry.txt")[FIRST]
    titles = {thing["key"]: thing["classTitle"] for thing in content["objects"]}
    (frame,) = (frame for frame in content["frames"] if frame["index"] == FIRST)
    cars = []
    for figure in frame["figures"]:
        place, turn, size = (
            np.array([figure["geometry"][key][axis] for axis in "xyz"])
            for key in ("position", "rotation", "dimensions")
        )
        center = map_from_lidar[:3, :3] @ place + map_from_lidar[:3, 3]
        at_the_curb = ((center[:2] > CURB[0]) & (center[:2] < CURB[1])).all()
        if titles[figure["objectKey"]] == "Car" and at_the_curb:
            cars.append((center, map_from_lidar[:3, :3] @ rotation_exp(turn), size))
    assert len(cars) == 2
    return cars
