from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import DataError
from pipeline.recording.left_behind import keep, restore
from pipeline.recording.mcap import McapReader, McapWriter


def test_what_a_start_left_comes_back_from_a_recording_whole_or_cut(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "map.npz").write_bytes(b"voxels")
    (folder / "empty").touch()
    file = tmp_path / "f.mcap"
    with McapWriter(file) as writer:
        keep(writer, folder)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-60])
    assert not McapReader(cut).is_whole()
    for number, path in enumerate((file, cut)):
        again = tmp_path / f"again-{number}"
        restore(McapReader(path), again)
        found = {str(p.relative_to(again)): p.read_bytes() for p in again.rglob("*") if p.is_file()}
        assert found == {"deep/map.npz": b"voxels", "empty": b""}


@pytest.mark.parametrize("name", ["run/../out.txt", "run//etc/out.txt", "run/"])
def test_no_file_is_written_outside_of_the_folder(tmp_path: Path, name: str) -> None:
    with McapWriter(tmp_path / "f.mcap") as writer:
        writer.attach(name, b"x")
    with pytest.raises(DataError, match="damaged: an attachment is called"):
        restore(McapReader(tmp_path / "f.mcap"), tmp_path / "run")


def test_what_others_attached_is_left_alone(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "f.mcap") as writer:
        writer.attach("notes.txt", b"x")
    restore(McapReader(tmp_path / "f.mcap"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
