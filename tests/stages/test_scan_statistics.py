"""Statistics files: what is read is checked, what is written leaves the rest alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.errors import DataError
from stages.scan_statistics import SHIPPED, ScanStatistics

OWN = ScanStatistics(
    (float(np.radians(-45)), float(np.radians(45))),
    np.array([8.5, -0.5, 0.8, 1.25, 0.0625], np.float32),
    np.array([6.25, 7.5, 6.5, 3.0, 0.0714], np.float32),
)


def read_back(text: str, folder: Path, sensor: str) -> ScanStatistics:
    file = folder / "written.yaml"
    file.write_text(text)
    return ScanStatistics.read(file, sensor)


@pytest.mark.parametrize("sensor", yaml.safe_load(SHIPPED.read_text()))
def test_every_shipped_entry_reads(sensor: str) -> None:
    assert ScanStatistics.read(SHIPPED, sensor).std.all()


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    for sensor in ("own", "on: off", "8"):
        text = OWN.written_to("", sensor, "a.pcap, 1 scan; remission=signal")
        found = read_back(text, tmp_path, sensor)
        np.testing.assert_array_equal(found.mean, OWN.mean)
        np.testing.assert_array_equal(found.std, OWN.std)
        np.testing.assert_allclose(found.elevation_rad, OWN.elevation_rad)
        assert yaml.safe_load(text)[sensor]["measured_on"] == "a.pcap, 1 scan; remission=signal"


def test_a_replaced_entry_leaves_the_others_and_all_comments(tmp_path: Path) -> None:
    before = """\
# of the file
first:   # of its line
    # a remark
    elevation_deg: [-1, 1]   # old
    mean: [0, 0, 0, 0, 0]
    std: [1, 1, 1, 1, 1]     # stays
# of the second
second: {elevation_deg: [-2, 2], mean: [0, 0, 0, 0, 0], std: [1, 1, 1, 1, 1]}  # flow
"""
    text = OWN.written_to(before, "first", "x")
    kept = [
        "# of the file",
        "first:   # of its line",
        "    # a remark",
        "# of the second",
        "# stays",
    ]
    assert [line for line in kept if line not in text] == []
    assert text.endswith(before[before.index("# of the second") :])
    assert read_back(text, tmp_path, "first").mean[0] == 8.5
    assert read_back(text, tmp_path, "second").mean[0] == 0
    flow = OWN.written_to(before, "second", "x")
    assert flow.startswith(before[: before.index("second:")])
    assert flow.endswith("  # flow\n")
    assert read_back(flow, tmp_path, "second").mean[0] == 8.5
    assert OWN.written_to(text, "first", "x") == text


def test_an_entry_is_added_at_the_end(tmp_path: Path) -> None:
    before = "first: {elevation_deg: [-1, 1], mean: [0, 0, 0, 0, 0], std: [1, 1, 1, 1, 1]}"
    text = OWN.written_to(before, "new", "x")
    assert text.startswith(before + "\nnew:\n")
    assert read_back(text, tmp_path, "first").mean[0] == 0
    assert read_back(text, tmp_path, "new").mean[0] == 8.5


def test_other_files_are_not_overwritten() -> None:
    for text in ("- a list", "{flow: 1}", "just words"):
        with pytest.raises(ValueError, match="holds no block of entries"):
            OWN.written_to(text, "own", "x")
    with pytest.raises(ValueError, match="is no YAML"):
        OWN.written_to("a: [", "own", "x")


def test_what_is_wrong_in_a_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no sensor 'os9' \(known: semantickitti, os0_128, "):
        ScanStatistics.read(SHIPPED, "os9")
    with pytest.raises(DataError, match="no scan statistics"):
        ScanStatistics.read(tmp_path / "absent.yaml", "own")
    for entry, said in {
        "{elevation_deg: [3, -25], mean: [0, 0, 0, 0, 0], std: [1, 1, 1, 1, 1]}": (
            r"elevation_deg is \[lowest, highest\]"
        ),
        "{elevation_deg: [-25, 3], mean: [0, 0], std: [1, 1]}": "take 5 numbers",
        "{elevation_deg: [-25, 3], mean: [0, 0, 0, 0, 0], std: [1, 1, 1, 1, 0]}": "std above 0",
        "3": "no scan statistics",
    }.items():
        with pytest.raises(DataError, match=said):
            read_back(f"own: {entry}", tmp_path, "own")


def test_a_network_is_adapted_to_a_sensor_in_its_view_z_and_remission() -> None:
    ones = np.ones(5, np.float32)
    network, own = (
        ScanStatistics((-0.4, 0.1), ones, ones),
        ScanStatistics((-1, 1), 2 * ones, 3 * ones),
    )
    fitted = network.adapted_to(own)
    assert fitted.elevation_rad == (-1, 1)
    assert fitted.mean.tolist() == [1, 1, 1, 2, 2]
    assert fitted.std.tolist() == [1, 1, 1, 3, 3]
    assert network.adapted_to(own, remission=False).mean.tolist() == [1, 1, 1, 2, 1]
