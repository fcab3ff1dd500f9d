"""`overflight statistics` on small drives, against NumPy, and what it leaves in the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pipeline.errors import DataError
from stages.scan_statistics import SHIPPED, ScanStatistics
from tools.statistics import elevation_of

Overflight = Callable[..., Any]

OWN_SOURCE = """\
from pathlib import Path
from collections.abc import Iterator
import numpy as np
from pipeline.message import Message
from pipeline.stage import Source
from stages.types import Scan

class Walls(Source):
    def __init__(self, *, path: Path, distance_m: float, stop_at: int = 99) -> None:
        self.distance_m, self.stop_at = distance_m, stop_at
    def messages(self) -> Iterator[Message[Scan]]:
        for k in range(5):
            if k == self.stop_at:
                raise KeyboardInterrupt
            points = np.array([[self.distance_m, 0, 1], [0, self.distance_m, -1]], np.float32)
            yield Message.at(k, Scan(points, None, None, None, "wall"))

class Hull(Source):
    def __init__(self, *, path: Path) -> None: ...
    def messages(self) -> Iterator[Message[Scan]]:
        points = np.array([[4, 0, 1], [0, 0.4, 0], [0, 4, -1]], np.float32)
        yield Message.at(0, Scan(points, None, None, None, "lidar"))

class Numbers(Source):
    def __init__(self, *, path: Path) -> None: ...
    def messages(self) -> Iterator[Message[int]]: ...

class Anywhere(Source):
    def messages(self) -> Iterator[Message[Scan]]: ...
"""


def rows_of(seed: int) -> np.ndarray:
    """Points (200, 4) in 200 columns of their own, within +-20 deg; the first has no return."""
    rng = np.random.default_rng(seed)
    azimuth = np.pi - (np.arange(200) + 0.5) * 2 * np.pi / 200
    elevation, r = np.radians(rng.uniform(-20, 20, 200)), rng.uniform(2, 30, 200)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    rows = np.column_stack([x * r, y * r, np.sin(elevation) * r, rng.random(200)])
    rows[0] = 0
    return rows.astype(np.float32)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Two scans in KITTI's layout."""
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    for number in range(2):
        rows_of(number).tofile(folder / f"{number:06}.bin")
    return tmp_path / "drive"


@pytest.fixture
def own_source(tmp_path: Path) -> str:
    """A source of the working folder."""
    (tmp_path / "my_walls.py").write_text(OWN_SOURCE)
    return "my_walls:Walls"


def test_the_figures_are_those_of_all_points(overflight: Overflight, drive: Path) -> None:
    answer = overflight("statistics", drive, "--columns", 200, "--elevation", -45, 45, "--json")
    assert answer.code == 0
    found = json.loads(answer.out)
    rows = np.concatenate([rows_of(0)[1:], rows_of(1)[1:]]).astype(np.float64)
    raw = np.column_stack([np.linalg.norm(rows[:, :3], axis=1), rows])
    for column, channel in enumerate(("range", "x", "y", "z", "remission")):
        own = found["channels"][channel]
        assert own["mean"] == pytest.approx(raw[:, column].mean(), abs=1e-4)
        assert own["std"] == pytest.approx(raw[:, column].std(), rel=1e-4)
    assert found["scans"] == 2
    assert found["points"] == 398
    assert found["points_outside"] == 0
    assert found["cells_filled"] == pytest.approx(398 / (2 * 64 * 200))
    assert found["adapted"] is None


def test_a_person_gets_a_table_and_what_lies_outside(overflight: Overflight, drive: Path) -> None:
    answer = overflight("statistics", drive, "--elevation", 0, 45, "--scans", 1)
    assert answer.code == 0
    assert [line.split()[0] for line in answer.out.splitlines()[1:6]] == [
        "range",
        "x",
        "y",
        "z",
        "remission",
    ]
    assert "1 scan as images of 64 x 512 over 0 .. 45 deg" in answer.out
    assert "of the points lie above or below" in answer.out


def test_the_field_of_view_is_that_of_the_first_scan(overflight: Overflight, drive: Path) -> None:
    found = json.loads(overflight("statistics", drive, "--json").out)
    x, y, z = rows_of(0)[1:, :3].T
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    lowest, highest = found["elevation_deg"]
    assert 0 <= elevation.min() - lowest <= 0.1
    assert 0 <= highest - elevation.max() <= 0.1


def test_a_network_is_adapted_in_z_and_remission_alone(overflight: Overflight, drive: Path) -> None:
    words = ("statistics", drive, "--adapt", "semantickitti", "--name", "mine", "-o", "own.yaml")
    answer = overflight(*words)
    assert answer.code == 0
    assert "Written: own.yaml, entry 'mine'" in answer.out
    written = ScanStatistics.read(Path("own.yaml"), "mine")
    network = ScanStatistics.read(SHIPPED, "semantickitti")
    own = json.loads(overflight("statistics", drive, "--json").out)["channels"]
    for key in ("mean", "std"):
        expected = [*getattr(network, key)[:3], own["z"][key], own["remission"][key]]
        np.testing.assert_allclose(getattr(written, key), expected, rtol=1e-3)
    entry = yaml.safe_load(Path("own.yaml").read_text())["mine"]
    assert entry["measured_on"] == "drive, 2 scans; range, x and y of semantickitti"


def test_remission_that_both_sensors_report_alike_may_stay_the_networks(
    overflight: Overflight, drive: Path
) -> None:
    words = ("statistics", drive, "--adapt", "semantickitti", "--keep-remission", "-o", "own.yaml")
    assert overflight(*words).code == 0
    written = ScanStatistics.read(Path("own.yaml"), "drive")
    network = ScanStatistics.read(SHIPPED, "semantickitti")
    assert written.mean[4] == network.mean[4]
    assert written.mean[3] != network.mean[3]
    entry = yaml.safe_load(Path("own.yaml").read_text())["drive"]
    assert entry["measured_on"] == "drive, 2 scans; range, x, y and remission of semantickitti"
    answer = overflight("statistics", drive, "--keep-remission")
    assert answer.code == 2
    assert "--keep-remission says how to --adapt a network" in answer.err


def test_the_vehicle_itself_is_left_out_of_the_figures(
    overflight: Overflight, own_source: str, tmp_path: Path
) -> None:
    words = ("--source", own_source.replace("Walls", "Hull"), "--json")
    found = json.loads(overflight("statistics", tmp_path / "any", *words).out)
    assert found["channels"]["range"]["mean"] == pytest.approx(np.sqrt(17))
    assert found["points"] == 3


def test_the_file_that_is_written_to_may_hold_the_network(
    overflight: Overflight, drive: Path
) -> None:
    Path("own.yaml").write_text(
        "# mine\nnet: {elevation_deg: [-25, 3], mean: [1, 2, 3, 4, 5], std: [1, 1, 1, 1, 1]}\n"
    )
    words = ("statistics", drive, "--adapt", "net", "-o", "own.yaml", "--json")
    assert json.loads(overflight(*words).out)["adapted"]["x"]["mean"] == 2
    assert Path("own.yaml").read_text().startswith("# mine\nnet: {elevation_deg: [-25, 3]")
    assert ScanStatistics.read(Path("own.yaml"), "drive").mean[1] == 2


def test_any_source_of_scans_can_be_measured(
    overflight: Overflight, own_source: str, tmp_path: Path
) -> None:
    words = ("--source", own_source, "--set", "distance_m=3.5", "-o", "own.yaml")
    answer = overflight("statistics", tmp_path / "any", *words)
    assert answer.code == 0
    assert "5 scans" in answer.out
    assert "The scans carry no remission" in answer.out
    entry = yaml.safe_load(Path("own.yaml").read_text())["any"]
    assert entry["measured_on"] == "any, 5 scans; distance_m=3.5"
    assert entry["mean"][1:] == [1.75, 1.75, 0, 0]


def test_a_flights_scans_are_its_topic_lidar(overflight: Overflight, tmp_path: Path) -> None:
    graph = (
        "overflight: 1\ngraph: g\nstages:\n"
        "  lidar: {use: stages.sources.emulated:EmulatedLidar, options: {count: 3}}\n"
        "  rgb: {use: stages.sources.emulated:EmulatedCamera, options: {count: 1}}\n"
    )
    (tmp_path / "g.yaml").write_text(graph)
    record = ("--record", "f.mcap", "--out", "out")
    assert overflight("run", "g.yaml", "--speed", "max", "--quiet", *record).code == 0
    assert "3 scans" in overflight("statistics", "f.mcap").out
    refused = overflight("statistics", "f.mcap", "--set", "topic=rgb")
    assert refused.code == 2
    assert "Image is no scan; name another --set topic=" in refused.err


def test_ctrl_c_gives_the_figures_so_far(overflight: Overflight, own_source: str) -> None:
    words = ("--source", own_source, "--set", "distance_m=3.5", "--set", "stop_at=2")
    answer = overflight("statistics", "any", *words)
    assert answer.code == 0
    assert "2 scans" in answer.out
    assert "Stopped by Ctrl-C: the figures are those of the scans so far." in answer.out
    answer = overflight("statistics", "any", *words[:-1], "stop_at=0")
    assert answer.code != 0
    assert answer.out == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["absent"], "absent: no such folder"),
        (["drive", "--adapt", "os9"], "no sensor 'os9'"),
        (["drive", "--elevation", "3", "-25"], "the lowest and then the highest"),
        (["drive", "--elevation", "60", "70"], "no scan with a return in the field of view"),
        (["drive", "--set", "rate_hs=1"], "no option 'rate_hs'; did you mean 'rate_hz'"),
        (["drive", "--set", "rate_hz"], "write name=value"),
        (["drive", "--set", "rate_hz=fast"], "rate_hz takes float"),
        (["drive", "--set", "start=-1"], "start -1 and stop None leave no frame"),
        (["drive", "--source", "detect"], "DetectObjects is no source of scans"),
        (["drive", "--source", "my_walls:Numbers"], "Numbers is no source of scans"),
        (["drive", "--source", "my_walls:Anywhere"], "Anywhere has no option 'path'"),
        (["drive", "--source", "my_walls:Walls"], "Walls needs --set distance_m="),
        (["drive", "-o", "list.yaml"], "list.yaml: holds no block of entries"),
        (["drive", "-o", "drive"], "cannot read drive"),
        (["drive", "-o", "list.yaml/own.yaml"], "cannot write list.yaml/own.yaml"),
    ],
)
def test_a_mistake_gets_one_sentence(
    overflight: Overflight, drive: Path, own_source: str, words: list[str], said: str
) -> None:
    Path("list.yaml").write_text("- 1\n")
    answer = overflight("statistics", *words)
    assert answer.code == 2
    text = " ".join(answer.err.replace("│", " ").split())
    assert said in text
    assert "Traceback" not in text


def test_the_vehicle_itself_and_what_is_not_finite_tell_no_field_of_view() -> None:
    points = np.array([[0.5, 0, -0.8], [np.nan, 1, 1], [np.inf, 0, 9], [0, 0, 0], [4, 0, 3]])
    assert elevation_of(points.astype(np.float32)) == (36.8, 36.9)
    with pytest.raises(DataError, match="give --elevation"):
        elevation_of(points[:4].astype(np.float32))


def test_a_real_drive_is_read(overflight: Overflight, shared: Path) -> None:
    folder = shared / "data" / "semantickitti_00"
    found = json.loads(overflight("statistics", folder, "--columns", 2048, "--json").out)
    network = ScanStatistics.read(SHIPPED, "semantickitti")
    x = found["channels"]["x"]["mean"]
    assert (x - network.mean[1]) / network.std[1] == pytest.approx(-1.05, abs=0.03)


def test_the_shipped_os0_128_is_that_of_the_recording(overflight: Overflight, shared: Path) -> None:
    pytest.importorskip("ouster.sdk", reason="needs the Ouster SDK: the extra 'ouster'")
    recording = shared / "data" / "ouster" / "OS-0-128-U1_v2.3.0_1024x10.pcap"
    found = json.loads(overflight("statistics", recording, "--json").out)["channels"]
    shipped = ScanStatistics.read(SHIPPED, "os0_128")
    np.testing.assert_allclose([own["mean"] for own in found.values()], shipped.mean, rtol=1e-3)
    np.testing.assert_allclose([own["std"] for own in found.values()], shipped.std, rtol=1e-3)
