"""The folder layouts in which drives of the KITTI family are handed around, behind one description.

The LiDAR is the base frame in all of them. Frames are numbered from the first scan; an image of the
same number was taken as the scan swept the camera's view, so both bear the same stamp.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.sources.kitti_files import (
    Matrix,
    Points,
    matrices,
    read_bin,
    read_calib_txt,
    read_json,
    read_npz,
    read_pcd,
    read_poses,
)
from stages.types import Calibration, Camera, SensorCalibration

CAMERA = "camera"  #: the sensors' names in the calibration
LIDAR = "lidar"


@dataclass(frozen=True, slots=True)
class Drive:
    """A recording: its files by frame number, and how to read them."""

    scans: Mapping[int, Path]
    images: Mapping[int, Path]
    read_scan: Callable[[Path], Points]
    read_poses: Callable[[], Matrix]  #: (frames, 4, 4) map_from_lidar
    read_calibration: Callable[[], Calibration]


def open_drive(path: Path) -> Drive:
    """The drive in a folder, whichever layout it has. Raises DataError."""
    if not path.is_dir():
        raise DataError(f"{path}: no such folder")
    for layout in (_decimated, _supervisely, _odometry, _rellis):
        drive = layout(path)
        if drive is not None:
            return drive
    raise DataError(
        f"{path}: no drive found; looked for lidar/*.npz, pointcloud/*.pcd, velodyne/*.bin and "
        "a RELLIS-3D frame (*.bin beside transforms.yaml)"
    )


def _decimated(path: Path) -> Drive | None:
    """lidar/NNN.npz (xyz in counts of 4 mm, inten 0..255), image/, calib.json, odometry poses."""
    scans = _numbered(path / "lidar", "*.npz")
    if not scans:
        return None
    return Drive(
        scans=_from_first(scans, scans),
        images=_from_first(_numbered(path / "image", "*.png"), scans),
        read_scan=read_npz,
        read_poses=partial(read_poses, path / "poses_lidar_odometry.txt"),
        read_calibration=partial(_calibration_of_json, path / "calib.json"),
    )


def _supervisely(path: Path) -> Drive | None:
    """pointcloud/N.pcd, image/N.png with N.png.json (matrices), odometry poses."""
    scans = _numbered(path / "pointcloud", "*.pcd")
    if not scans:
        return None
    images = _numbered(path / "image", "*.png")
    return Drive(
        scans=_from_first(scans, scans),
        images=_from_first(images, scans),
        read_scan=read_pcd,
        read_poses=partial(read_poses, path / "poses_lidar_odometry.txt"),
        read_calibration=partial(_calibration_of_supervisely, path, list(images.values())),
    )


def _odometry(path: Path) -> Drive | None:
    """velodyne/N.bin, image_2/N.png, calib.txt, poses.txt: KITTI odometry and SemanticKITTI."""
    scans = _numbered(path / "velodyne", "*.bin")
    if not scans:
        return None
    images = _numbered(path / "image_2", "*.png")
    return Drive(
        scans=_from_first(scans, scans),
        images=_from_first(images, scans),
        read_scan=read_bin,
        read_poses=partial(_read_camera_poses, path),
        read_calibration=partial(_calibration_of_odometry, path, list(images.values())),
    )


def _rellis(path: Path) -> Drive | None:
    """One frame of RELLIS-3D: NNNNNN.bin, frame*.jpg, camera_info.txt, transforms.yaml."""
    scans = _numbered(path, "[0-9]*.bin")
    if not scans or not (path / "transforms.yaml").is_file():
        return None
    images = sorted(path.glob("frame*.jpg"))
    return Drive(
        scans=_from_first(scans, scans),
        images=dict(enumerate(images)),
        read_scan=read_bin,
        read_poses=partial(read_poses, path / "poses.txt"),
        read_calibration=partial(_calibration_of_rellis, path, images),
    )


def _numbered(folder: Path, pattern: str) -> dict[int, Path]:
    """The files of a folder by the number that is their name."""
    files = {}
    for path in sorted(folder.glob(pattern)):
        if not path.stem.isdecimal():
            raise DataError(f"{path}: the name is no frame number; take it out of the folder")
        files[int(path.stem)] = path
    return files


def _from_first(files: Mapping[int, Path], scans: Mapping[int, Path]) -> dict[int, Path]:
    """The same counted from the first scan; what lies before it is left out."""
    first = min(scans)
    return {number - first: path for number, path in files.items() if number >= first}


def _read_camera_poses(path: Path) -> Matrix:
    """poses.txt holds map_from_camera0; with Tr of calib.txt they become map_from_lidar, the map
    being the LiDAR frame of the first scan."""
    poses = read_poses(path / "poses.txt")
    camera_from_lidar = matrices(read_calib_txt(path / "calib.txt", "Tr"))[0]
    return np.asarray(np.linalg.inv(camera_from_lidar) @ poses @ camera_from_lidar)


def _calibration_of_json(path: Path) -> Calibration:
    content = read_json(path)
    try:
        size = tuple(content["image_size"])
        return _calibrated(np.array(content["K"]), np.array(content["T_cam_lidar"]), size)
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(f"{path}: needs K, T_cam_lidar and image_size ({error!r})") from error


def _calibration_of_supervisely(path: Path, images: Sequence[Path]) -> Calibration:
    file = _first(path, images)
    file = file.with_name(file.name + ".json")
    content = read_json(file)
    try:
        sensors = content["meta"]["sensorsData"]
        size = (int(content["fileMeta"]["width"]), int(content["fileMeta"]["height"]))
        intrinsic = np.array(sensors["intrinsicMatrix"], dtype=np.float64).reshape(3, 3)
        extrinsic = np.array(sensors["extrinsicMatrix"], dtype=np.float64)
        return _calibrated(intrinsic, extrinsic, size)
    except (KeyError, ValueError, TypeError) as error:
        raise DataError(f"{file}: holds no camera matrices ({error!r})") from error


def _calibration_of_odometry(path: Path, images: Sequence[Path]) -> Calibration:
    projection = read_calib_txt(path / "calib.txt", "P2").reshape(3, 4)
    camera_from_lidar = matrices(read_calib_txt(path / "calib.txt", "Tr"))[0]
    # P2 = K [I | t]: camera 2 stands t beside camera 0, in whose frame Tr is.
    camera_from_lidar[:3, 3] += np.linalg.inv(projection[:, :3]) @ projection[:, 3]
    return _calibrated(projection[:, :3], camera_from_lidar[:3], _size(_first(path, images)))


def _calibration_of_rellis(path: Path, images: Sequence[Path]) -> Calibration:
    """transforms.yaml holds the camera's pose in the LiDAR frame: quaternion q and position t."""
    file = path / "transforms.yaml"
    try:
        fx, fy, cx, cy = np.loadtxt(path / "camera_info.txt", dtype=np.float64)
        (pose,) = yaml.safe_load(file.read_text(encoding="utf-8")).values()
        w, x, y, z = (float(pose["q"][axis]) for axis in "wxyz")
        position = np.array([float(pose["t"][axis]) for axis in "xyz"])
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise DataError(f"{file}: no camera pose beside camera_info.txt ({error!r})") from error
    imaginary = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = 2 * np.outer(imaginary, imaginary) + 2 * w * cross
    rotation += (w * w - imaginary @ imaginary) * np.eye(3)
    camera_from_lidar = np.hstack([rotation.T, -rotation.T @ position[:, None]])
    intrinsic = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return _calibrated(intrinsic, camera_from_lidar, _size(_first(path, images)))


def _calibrated(
    intrinsic: Matrix, camera_from_lidar: NDArray[np.float64], size: tuple[int, ...]
) -> Calibration:
    width, height = size
    camera = Camera(
        size=(width, height),
        fx=float(intrinsic[0, 0]),
        fy=float(intrinsic[1, 1]),
        cx=float(intrinsic[0, 2]),
        cy=float(intrinsic[1, 2]),
    )
    base_from_camera = np.linalg.inv(matrices(camera_from_lidar)[0])
    return Calibration(
        {LIDAR: SensorCalibration(np.eye(4)), CAMERA: SensorCalibration(base_from_camera, camera)}
    )


def _first(path: Path, images: Sequence[Path]) -> Path:
    if not images:
        raise DataError(f"{path}: has no images, so there is no camera to calibrate")
    return images[0]


def _size(image: Path) -> tuple[int, int]:
    picture = cv2.imread(str(image))
    if picture is None:
        raise DataError(f"{image}: is no picture that can be read")
    return picture.shape[1], picture.shape[0]
