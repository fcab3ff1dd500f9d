"""Real data: image labels carried to the cloud agree with the cloud's own labels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from stages.frames import look, mounted
from stages.types import Calibration


def rellis_calibration(folder: Path) -> Calibration:
    fx, fy, cx, cy = (float(x) for x in (folder / "camera_info.txt").read_text().split())
    mount = yaml.safe_load((folder / "transforms.yaml").read_text())
    pose = mount["os1_cloud_node-pylon_camera_node"]  # p_camera = R(q)^T (p_lidar - t)
    return Calibration.parse(
        {
            "lidar": {"base_from_sensor": np.eye(4).tolist()},
            "rgb": {
                "base_from_sensor": {
                    "translation": [pose["t"][axis] for axis in "xyz"],
                    "quaternion": [pose["q"][axis] for axis in "xyzw"],
                },
                "camera": {"size": [1920, 1200], "fx": fx, "fy": fy, "cx": cx, "cy": cy},
            },
        }
    )


def test_image_labels_on_a_rellis_cloud_agree_with_its_own(shared: Path) -> None:
    folder = shared / "data" / "rellis3d_000104"
    points = np.fromfile(folder / "000104.bin", np.float32).reshape(-1, 4)[:, :3]
    truth = np.fromfile(folder / "000104.label", np.uint32) & 0xFFFF
    image = cv2.imread(str(folder / "frame000104-1581624663_149.png"), cv2.IMREAD_UNCHANGED)
    calibration = rellis_calibration(folder)
    usable = points.any(axis=1)
    view = look(calibration.camera("rgb"), points, usable, mounted(calibration, "rgb", "lidar"))
    u, v = np.rint(view.pixel).astype(int).T
    agreement = (image[v, u] == truth[view.index]).mean()
    assert len(view.index) == pytest.approx(7_428, abs=20)
    assert agreement == pytest.approx(0.773, abs=0.005)
