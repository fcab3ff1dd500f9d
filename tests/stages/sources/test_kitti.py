from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import DataError
from stages.sources.kitti import KittiImages, KittiPoses, KittiScans, calibration
from stages.types import Image, Pose, Scan

POINTS = np.array([[1.0, -2.0, 0.5, 0.25], [10.0, 0.0, -1.0, 1.0]], dtype=np.float32)
CAMERA_FROM_LIDAR = np.array([[0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, 0.3]], dtype=np.float64)
K = np.array([[100, 0, 8], [0, 110, 4], [0, 0, 1]], dtype=np.float64)


def poses_text(count: int) -> str:
    lines = []
    for number in range(count):
        pose = np.eye(4)
        pose[0, 3] = number
        lines.append(" ".join(map(str, pose[:3].ravel())))
    return "\n".join(lines) + "\n"


def write_image(path: Path) -> None:
    """A picture whose RGB is (200, 100, 50)."""
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.full((6, 16, 3), (50, 100, 200), dtype=np.uint8))


def decimated(path: Path, frames: int = 3) -> Path:
    (path / "lidar").mkdir()
    for number in range(frames):
        xyz = np.round(POINTS[:, :3] / 0.004).astype(np.int16)
        intensity = np.round(POINTS[:, 3] * 255).astype(np.uint8)
        np.savez(path / "lidar" / f"{number:03}.npz", xyz=xyz, inten=intensity)
        write_image(path / "image" / f"{number:03}.png")
    content = {"K": K.tolist(), "T_cam_lidar": CAMERA_FROM_LIDAR.tolist(), "image_size": [16, 6]}
    (path / "calib.json").write_text(json.dumps(content))
    (path / "poses_lidar_odometry.txt").write_text(poses_text(frames))
    return path


def supervisely(path: Path, frames: int = 3) -> Path:
    (path / "pointcloud").mkdir()
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {len(POINTS)}\nHEIGHT 1\nPOINTS {len(POINTS)}\nDATA binary\n"
    )
    sensors = {
        "extrinsicMatrix": CAMERA_FROM_LIDAR.ravel().tolist(),
        "intrinsicMatrix": K.ravel().tolist(),
    }
    meta = {"meta": {"sensorsData": sensors}, "fileMeta": {"width": 16, "height": 6}}
    for number in range(20, 20 + frames):
        scan = path / "pointcloud" / f"{number:010}.pcd"
        scan.write_bytes(head.encode() + POINTS.tobytes() + bytes(64))  # padded, as they come
        write_image(path / "image" / f"{number:010}.png")
        (path / "image" / f"{number:010}.png.json").write_text(json.dumps(meta))
    (path / "poses_lidar_odometry.txt").write_text(poses_text(frames))
    return path


def odometry(path: Path, frames: int = 3) -> Path:
    (path / "velodyne").mkdir()
    for number in range(frames):
        (path / "velodyne" / f"{number:06}.bin").write_bytes(POINTS.tobytes())
        write_image(path / "image_2" / f"{number:06}.png")
    projection = " ".join(map(str, np.hstack([K, np.zeros((3, 1))]).ravel()))
    camera = " ".join(map(str, CAMERA_FROM_LIDAR.ravel()))
    (path / "calib.txt").write_text(f"P2: {projection}\nTr: {camera}\n")
    camera_from_lidar = np.vstack([CAMERA_FROM_LIDAR, [0, 0, 0, 1]])
    lines = []
    for number in range(frames):
        pose = np.eye(4)
        pose[0, 3] = number
        in_camera = camera_from_lidar @ pose @ np.linalg.inv(camera_from_lidar)
        lines.append(" ".join(map(str, in_camera[:3].ravel())))
    (path / "poses.txt").write_text("\n".join(lines))
    return path


@pytest.fixture(params=[decimated, supervisely, odometry])
def drive(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    folder: Path = request.param(tmp_path)
    return folder


def test_every_layout_gives_the_same_drive(drive: Path) -> None:
    images, scans, poses = KittiImages(path=drive), KittiScans(path=drive), KittiPoses(path=drive)
    for source in (images, scans, poses):
        source.open()
    stamps = [0, 100_000_000, 200_000_000]
    taken = list(images.messages())
    assert [message.stamp for message in taken] == stamps
    assert isinstance(taken[0].payload, Image)
    assert taken[0].payload.data.shape == (6, 16, 3)
    assert taken[0].payload.data[0, 0].tolist() == [200, 100, 50]

    swept = list(scans.messages())
    assert [message.stamp for message in swept] == stamps
    assert isinstance(swept[0].payload, Scan)
    np.testing.assert_allclose(swept[1].payload.points, POINTS[:, :3], atol=0.002)
    assert swept[1].payload.remission is not None
    np.testing.assert_allclose(swept[1].payload.remission, POINTS[:, 3], atol=0.002)

    flown = list(poses.messages())
    assert [message.stamp for message in flown] == stamps
    assert isinstance(flown[2].payload, Pose)
    expected = np.eye(4)
    expected[0, 3] = 2
    np.testing.assert_allclose(flown[2].payload.map_from_base, expected, atol=1e-9)


def test_every_layout_gives_the_same_calibration(drive: Path) -> None:
    found = calibration(path=drive)
    camera = found.sensor("camera").camera
    assert camera is not None
    assert (camera.size, camera.fx, camera.fy, camera.cx, camera.cy) == ((16, 6), 100, 110, 8, 4)
    camera_from_base = np.linalg.inv(found.sensor("camera").base_from_sensor)
    np.testing.assert_allclose(camera_from_base[:3], CAMERA_FROM_LIDAR, atol=1e-12)
    np.testing.assert_array_equal(found.sensor("lidar").base_from_sensor, np.eye(4))


def test_frames_may_be_chosen_and_restamped(tmp_path: Path) -> None:
    drive = decimated(tmp_path, frames=4)
    scans = KittiScans(path=drive, rate_hz=20, offset_ms=7, delay_ms=30, start=1, stop=3)
    scans.open()
    found = [(message.stamp, message.received) for message in scans.messages()]
    assert found == [(57_000_000, 87_000_000), (107_000_000, 137_000_000)]
    assert scans.last_arrival() == 137_000_000
    timing = scans.timing()
    assert (timing.rate_hz, timing.delay_ms) == (20, 30)


def test_a_missing_image_leaves_a_gap_and_shifts_nothing(tmp_path: Path) -> None:
    drive = supervisely(tmp_path)
    (drive / "image" / "0000000021.png").unlink()
    images = KittiImages(path=drive)
    images.open()
    assert [message.stamp for message in images.messages()] == [0, 200_000_000]


def test_a_folder_without_a_drive_is_told_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no drive found; looked for lidar/\*.npz"):
        KittiScans(path=tmp_path).open()
    with pytest.raises(DataError, match="nowhere: no such folder"):
        KittiScans(path=tmp_path / "nowhere").open()


@pytest.mark.parametrize(
    ("layout", "file", "content", "said"),
    [
        (decimated, "lidar/001.npz", b"PK", "001.npz: no scan of arrays"),
        (odometry, "velodyne/000001.bin", b"12345", "5 bytes are no rows of four float32"),
        (supervisely, "pointcloud/0000000021.pcd", b"VERSION 0.7", "no binary PCD of float32"),
    ],
)
def test_a_broken_scan_is_named(
    tmp_path: Path, layout: object, file: str, content: bytes, said: str
) -> None:
    assert callable(layout)
    layout(tmp_path)
    (tmp_path / file).write_bytes(content)
    scans = KittiScans(path=tmp_path)
    scans.open()
    with pytest.raises(DataError, match=said):
        list(scans.messages())


def test_a_cut_off_scan_is_named(tmp_path: Path) -> None:
    file = supervisely(tmp_path) / "pointcloud" / "0000000020.pcd"
    file.write_bytes(file.read_bytes()[:-80])
    scans = KittiScans(path=tmp_path)
    scans.open()
    with pytest.raises(DataError, match="ends after 1 of 2 points; fetch it again"):
        list(scans.messages())


def test_a_broken_image_and_broken_poses_are_named(tmp_path: Path) -> None:
    drive = decimated(tmp_path)
    (drive / "image" / "000.png").write_bytes(b"no picture")
    (drive / "poses_lidar_odometry.txt").write_text("1 2 3\n")
    images = KittiImages(path=drive)
    images.open()
    with pytest.raises(DataError, match=r"000.png: is no picture"):
        list(images.messages())
    with pytest.raises(DataError, match="every line needs the 12 numbers of a pose"):
        KittiPoses(path=drive).open()


def test_a_file_whose_name_is_no_number_is_named(tmp_path: Path) -> None:
    drive = decimated(tmp_path)
    (drive / "lidar" / "copy.npz").write_bytes(b"")
    with pytest.raises(DataError, match=r"copy\.npz: the name is no frame number"):
        KittiScans(path=drive).open()


def test_no_frame_left_is_a_bad_option() -> None:
    with pytest.raises(ValueError, match="leave no frame"):
        KittiScans(path=Path("x"), start=3, stop=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frames"), [("kitti_drive_lite108", 108), ("kitti_drive_full6", 6)]
)
def test_the_real_drives_read(shared: Path, name: str, frames: int) -> None:
    path = shared / "data" / name
    for make in (KittiImages, KittiScans, KittiPoses):
        source = make(path=path)
        source.open()
        assert len(list(source.messages())) == frames
    camera = calibration(path=path).sensor("camera").camera
    assert camera is not None


def test_rellis_labels_of_points_agree_with_the_labels_of_the_pixels_they_fall_on(
    shared: Path,
) -> None:
    """77.3 % is what a correct transform gives on this frame; the inverse one gives 0.0 %."""
    path = shared / "data" / "rellis3d_000104"
    scans = KittiScans(path=path)
    scans.open()
    (scan,) = scans.messages()
    found = calibration(path=path).sensor("camera")
    assert found.camera is not None
    labels = np.fromfile(path / "000104.label", dtype=np.uint32) & 0xFFFF
    pixels = cv2.imread(str(path / "frame000104-1581624663_149.png"), cv2.IMREAD_GRAYSCALE)
    homogeneous = np.hstack([scan.payload.points, np.ones((len(scan.payload.points), 1))])
    x, y, z = (np.linalg.inv(found.base_from_sensor) @ homogeneous.T)[:3]
    ahead = z > 0.1
    u = np.rint(found.camera.fx * x[ahead] / z[ahead] + found.camera.cx).astype(int)
    v = np.rint(found.camera.fy * y[ahead] / z[ahead] + found.camera.cy).astype(int)
    width, height = found.camera.size
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    agree = pixels[v[inside], u[inside]] == labels[ahead][inside]
    assert agree.mean() == pytest.approx(0.773, abs=0.005)
