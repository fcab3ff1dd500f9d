"""Paris-CARLA-3D's layout, sound and broken, and the scans that are simulated of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from tools.train.aggregated import SimulatedViews, scan_from
from tools.train.open_scans import open_scans
from tools.train.readers.paris_carla import open_views, read_cloud

ROAD, VEHICLE = 3, 13
FIELDS = (
    ("x", "f8"), ("y", "f8"), ("z", "f8"), ("timestamp", "f8"),
    ("x_origin", "f8"), ("y_origin", "f8"), ("z_origin", "f8"),
    ("intensity", "u1"), ("semantic", "u1"), ("instance", "u2"),
)  # fmt: skip
NAMES = {"f8": "double", "u1": "uchar", "u2": "ushort"}


def street(path: Path, *, without: tuple[str, ...] = ()) -> Path:
    """A road of CARLA's tag 7, a vehicle (10) that drives along it, the sensor behind; 2 s long."""
    random = np.random.default_rng(0)
    rows = []
    for scan in range(20):
        road = random.uniform([-30, -6, 0], [30, 6, 0.02], (2000, 3))
        car = random.uniform([-8, -1, 0.4], [-5, 1, 1.6], (150, 3)) + np.array([scan * 1.0, 0, 0])
        for points, tag in ((road, 7), (car, 10)):
            part = np.zeros(len(points), np.dtype(list(FIELDS)))
            part["x"], part["y"], part["z"] = (points + np.array([65_000, 12_000, 40])).T
            part["timestamp"] = 1e5 + (scan + np.linspace(0.01, 0.99, len(part))) * 0.1
            part["x_origin"] = 65_000 - 20 + scan
            part["y_origin"], part["z_origin"] = 12_000, 42
            part["semantic"], part["intensity"] = tag, 51
            rows.append(part)
    vertices = np.concatenate(rows)
    kept = [name for name, _ in FIELDS if name not in without]
    vertices = vertices[kept].astype([(n, t) for n, t in FIELDS if n in kept])
    head = [f"property {NAMES[t]} {n}" for n, t in FIELDS if n in kept]
    text = "\n".join(
        ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *head]
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() + b"\nend_header\n" + vertices.tobytes())
    return path


def test_a_street_has_our_classes_its_scans_and_where_the_sensor_was(tmp_path: Path) -> None:
    cloud = read_cloud(street(tmp_path / "train" / "Soldat_1.ply"))
    assert np.unique(cloud.classes).tolist() == [ROAD, VEHICLE]
    assert len(cloud.path) == 20
    np.testing.assert_allclose(np.diff(cloud.path[:, 0]), 1.0, atol=1e-6)
    assert abs(cloud.points).max() < 60  # near the origin: no digits are lost
    assert cloud.remission[0] == pytest.approx(0.2)
    assert len(open_scans(tmp_path)) == 4  # every fifth scan is a viewpoint


@pytest.mark.parametrize(("window", "meters"), [(0, 3), (2, 7), (5, 13)])
def test_what_moves_is_smeared_over_the_window_alone(
    window: int, meters: int, tmp_path: Path
) -> None:
    cloud = read_cloud(street(tmp_path / "a.ply"))
    view = scan_from(cloud, cloud.path[10] + [0, 0, 3.0], 10, window=window)
    x = view.points[view.classes == VEHICLE, 0]
    assert np.ptp(x) == pytest.approx(meters, abs=0.7)
    assert np.count_nonzero(view.classes == ROAD) > 5000


def test_the_view_is_organized_raised_and_ends_at_the_range(tmp_path: Path) -> None:
    source = open_views(street(tmp_path / "a.ply"))
    assert isinstance(source, SimulatedViews)
    one, again = source.read(2), source.read(2)
    np.testing.assert_array_equal(one.points, again.points)
    assert one.shape == (128, 1024)
    assert len(one.points) == 128 * 1024
    hit = one.points.any(axis=1)
    assert np.linalg.norm(one.points[hit], axis=1).max() <= 50
    height = -one.points[one.classes == ROAD, 2] - 2.0  # the sensor drove 2 m above the road
    assert 5 - 0.1 <= np.median(height) <= 15 + 0.1
    assert (one.classes[~hit] == 0).all()


def test_positions_may_lie_beside_the_file(tmp_path: Path) -> None:
    file = street(tmp_path / "a.ply", without=("x_origin", "y_origin", "z_origin"))
    with pytest.raises(DataError, match=r"does not say where the sensor was; give a\.path\.txt"):
        read_cloud(file)
    poses = np.column_stack([1e5 + np.arange(0, 3, 0.5), np.arange(6.0), np.zeros(6), np.ones(6)])
    np.savetxt(tmp_path / "a.path.txt", poses)
    path = read_cloud(file).path
    assert np.ptp(path[:, 0]) > 3
    (tmp_path / "a.path.txt").write_text("1 2 3\n")
    with pytest.raises(DataError, match="every line is 'time x y z'"):
        read_cloud(file)


@pytest.mark.parametrize(
    ("without", "said"), [("semantic", "have no tags"), ("timestamp", "have no time")]
)
def test_what_a_street_lacks_is_said(without: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=said):
        read_cloud(street(tmp_path / "a.ply", without=(without,)))


def test_a_cut_file_and_several_streets_are_said(tmp_path: Path) -> None:
    file = street(tmp_path / "train" / "a.ply")
    street(tmp_path / "train" / "b.ply")
    with pytest.raises(DataError, match="holds 2 streets; name them one by one"):
        open_views(tmp_path)
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(DataError, match="fetch it again"):
        read_cloud(file)
