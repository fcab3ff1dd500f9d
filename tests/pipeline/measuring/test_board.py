from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from pipeline.measuring import board as module
from pipeline.measuring.board import Board, boards, folder, read_board

CRASH = """
import os, signal, sys
from pathlib import Path
from pipeline.measuring.board import Board
Board(Path(sys.argv[1])).write({"graph": "crashed"})
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_is_put_up_is_read(tmp_path: Path) -> None:
    with Board(tmp_path) as board:
        for page in ({"graph": "a", "long": "x" * 9000}, {"graph": "ä"}):
            board.write(page)
            assert read_board(board.path) == page
        assert list(boards(tmp_path)) == [board.path]


def test_a_board_is_taken_down_at_the_end(tmp_path: Path) -> None:
    with Board(tmp_path) as board:
        board.write({})
    assert list(tmp_path.iterdir()) == []
    assert read_board(board.path) is None


def test_only_the_owner_may_read_it(tmp_path: Path) -> None:
    with Board(tmp_path) as board:
        assert board.path.stat().st_mode & 0o777 == 0o600


def test_several_runs_of_one_process_have_a_board_each(tmp_path: Path) -> None:
    with Board(tmp_path) as one, Board(tmp_path) as other:
        one.write({"graph": "one"})
        other.write({"graph": "other"})
        graphs = [page["graph"] for path in boards(tmp_path) if (page := read_board(path))]
        assert graphs == ["one", "other"]


def test_the_next_start_removes_what_a_killed_run_left(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", CRASH, str(tmp_path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    with Board(tmp_path) as board:
        assert list(tmp_path.iterdir()) == [board.path]


def test_a_board_that_is_just_being_put_up_is_left_alone(tmp_path: Path) -> None:
    young, old = tmp_path / "1-0.run", tmp_path / "2-0.run"
    for path in (young, old):
        path.touch()
    os.utime(old, (0, 0))
    os.utime(young, (later := time.time() + 600, later))  # young, however long this takes
    assert list(boards(tmp_path)) == [young]
    assert not old.exists()


@pytest.mark.parametrize("harm", ["half", "empty", "other"])
def test_a_page_that_is_not_whole_is_not_read(
    harm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_PAUSE_S", 0.0)
    with Board(tmp_path) as board:
        board.write({"graph": "uav"})
        content = board.path.read_bytes()
        harmed = {
            "half": content[:-4],
            "empty": b"",
            "other": content.replace(b"uav", b"car"),
        }
        board.path.write_bytes(harmed[harm])
        assert read_board(board.path) is None


def test_boards_are_in_the_users_runtime_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert folder() == tmp_path / "overflight"
    assert folder().stat().st_mode & 0o777 == 0o700


def test_without_one_they_are_in_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    assert folder() == tmp_path / f"overflight-{os.getuid()}"


@pytest.mark.parametrize("trap", ["open to all", "link", "file"])
def test_a_folder_that_others_could_have_laid_is_refused(
    trap: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "overflight"
    if trap == "link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        path.symlink_to(tmp_path / "theirs")
    elif trap == "file":
        path.touch()
    else:
        path.mkdir()
        path.chmod(0o777)
    with pytest.raises(PermissionError, match="of this user alone"):
        folder()
