"""Data sets of labeled scans in their public layouts, sound and broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_folders import sequence

from pipeline.errors import DataError
from tools.train.open_scans import open_scans

ROAD, VEHICLE, SIDEWALK = 3, 13, 4


def test_a_sequence_of_semantickitti_has_our_classes(tmp_path: Path) -> None:
    source = open_scans(sequence(tmp_path / "00"))
    assert len(source) == 3
    one = source.read(1)
    assert one.points.shape == (1850, 3)
    assert np.unique(one.classes).tolist() == [0, ROAD, VEHICLE]
    assert one.classes[1500] == VEHICLE  # the instance in the high bits is no part of the class
    assert one.remission[0] == pytest.approx(0.2)


def test_many_sequences_are_one_source(tmp_path: Path) -> None:
    for name in ("00", "01"):
        sequence(tmp_path / "dataset" / "sequences" / name)
    assert len(open_scans(tmp_path)) == 6
    assert "00, 01: 6 scans" in open_scans(tmp_path).told


def test_our_own_labels_say_whose_ids_they_are_and_how_the_scan_is_laid_out(
    tmp_path: Path,
) -> None:
    folder = sequence(tmp_path / "own", scans=1)
    np.full(1850, SIDEWALK, "<u4").tofile(folder / "labels/000000.label")
    (folder / "sequence.yaml").write_text("labels: overflight\nshape: [10, 185]\n")
    one = open_scans(folder).read(0)
    assert set(one.classes) == {SIDEWALK}
    assert one.shape == (10, 185)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda f: (f / "velodyne/000001.bin").unlink(), "its scan 000001.bin is missing"),
        (lambda f: (f / "labels/000001.label").write_bytes(b"1234" * 7), "7 labels for the 1850"),
        (lambda f: (f / "velodyne/000001.bin").write_bytes(b"12345"), "no rows of four float32"),
        (lambda f: (f / "sequence.yaml").write_text("shape: [3, 3]"), "are no 3 x 3 scan"),
        (lambda f: (f / "sequence.yaml").write_text("{"), "says nothing of labels and shape"),
        (
            lambda f: np.full(1850, 77, "<u4").tofile(f / "labels/000001.label"),
            "'semantickitti' has no class 77",
        ),
        (lambda f: [one.unlink() for one in f.glob("labels/*")], "is it a test sequence"),
    ],
)
def test_a_broken_sequence_is_said_with_the_file(tmp_path: Path, broken, said: str) -> None:  # type: ignore[no-untyped-def]
    folder = sequence(tmp_path / "00")
    broken(folder)
    with pytest.raises(DataError, match=said) as error:
        open_scans(folder).read(1)
    assert "/00/" in str(error.value) or str(error.value).startswith(str(folder))


def test_range_images_of_pcl_segmentation(tmp_path: Path) -> None:
    image = np.zeros((32, 240, 6))
    image[..., 5] = 10  # none
    image[3, 7] = [5, 1, -1, 120, 5.2, 7]  # a car
    np.save(tmp_path / "a.npy", image)
    one = open_scans(tmp_path).read(0)
    assert np.count_nonzero(one.points.any(axis=1)) == 1
    assert one.classes[3 * 240 + 7] == VEHICLE
    assert one.remission[3 * 240 + 7] == pytest.approx(120 / 255)
    np.save(tmp_path / "b.npy", np.zeros((32, 240)))
    with pytest.raises(DataError, match=r"b\.npy: of shape \(32, 240\)"):
        open_scans(tmp_path).read(1)
    (tmp_path / "b.npy").write_text("no array")
    with pytest.raises(DataError, match=r"b\.npy: is no array"):
        open_scans(tmp_path).read(1)


def test_what_is_no_data_set_is_said_with_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no labeled scans found; looked for flights: .*semantic"):
        open_scans(tmp_path)
    with pytest.raises(DataError, match="no such file"):
        open_scans(tmp_path / "nowhere")
    with pytest.raises(DataError, match="no layout 'kitti'"):
        open_scans(tmp_path, "kitti")


def test_the_shared_scans_are_read(shared: Path) -> None:
    kitti = open_scans(shared / "data/semantickitti_00")
    one = kitti.read(0)
    assert len(kitti) == 3
    assert (one.classes > 0).mean() > 0.9
    sectors = open_scans(shared / "models/ika-pcl")
    assert len(sectors) == 35
    assert VEHICLE in sectors.read(0).classes
