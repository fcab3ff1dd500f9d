"""Shared memory files: locked while their owner lives, swept when it is gone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipeline.errors import TransportError
from pipeline.transport.shared_files import create, open_to_read, sweep


def test_a_file_belongs_to_its_user_alone_and_names_its_run(tmp_path: Path) -> None:
    name, descriptor = create("flight-1", 4096, tmp_path)
    status = (tmp_path / name).stat()
    os.close(descriptor)
    assert status.st_mode & 0o777 == 0o600
    assert status.st_size == 4096
    assert "flight-1" in name


def test_a_sweep_leaves_files_whose_owner_lives_and_removes_the_others(tmp_path: Path) -> None:
    living, descriptor = create("run", 10, tmp_path)
    dead, orphan = create("run", 10, tmp_path)
    os.close(orphan)  # as the kernel does for a process that is killed
    (tmp_path / "somebody-elses").touch()
    assert sweep(folder=tmp_path) == [dead]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([living, "somebody-elses"])
    os.close(descriptor)


def test_a_sweep_of_one_run_leaves_other_runs(tmp_path: Path) -> None:
    for run in ("one", "other"):
        os.close(create(run, 10, tmp_path)[1])
    assert len(sweep("one", tmp_path)) == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_a_reader_of_a_file_does_not_keep_it_from_a_sweep(tmp_path: Path) -> None:
    name, descriptor = create("run", 10, tmp_path)
    reader = open_to_read(name, tmp_path)
    os.close(descriptor)
    assert sweep(folder=tmp_path) == [name]
    os.close(reader)


@pytest.mark.parametrize("name", ["../etc/passwd", "overflight-../x", "/dev/null", "", "x", "a\0b"])
def test_a_name_that_is_none_of_ours_is_never_opened(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="no name of shared memory"):
        open_to_read(name, tmp_path)


def test_links_and_pipes_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "overflight-link").symlink_to("/etc/hostname")
    os.mkfifo(tmp_path / "overflight-pipe")
    with pytest.raises(OSError, match="symbolic"):
        open_to_read("overflight-link", tmp_path)
    with pytest.raises(ValueError, match="another user"):
        open_to_read("overflight-pipe", tmp_path)
    assert sweep(folder=tmp_path) == []


def test_without_room_the_error_says_how_much_and_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(TransportError, match=r"no .* MB of shared memory in .*; free some"):
        create("run", 1 << 50, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_run_whose_name_is_a_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="no name of a run"):
        create("../run", 10, tmp_path)
