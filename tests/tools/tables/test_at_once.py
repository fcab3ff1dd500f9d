"""Work in several processes at once, failed and killed for real."""

from __future__ import annotations

import os
import signal
import time
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest
from rich.console import Console

from pipeline.errors import DataError
from tools.tables.at_once import at_once


def mark(file: Path, console: Console) -> None:
    file.touch()
    console.print("made\nit")


def fail(console: Console) -> None:
    raise DataError("no data")


def die(console: Console) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def train(folder: Path, console: Console) -> None:
    """Until it is asked to end; then it saves."""
    try:
        (folder / "begun").touch()
        time.sleep(60)
    except KeyboardInterrupt:
        (folder / "saved").touch()
        raise


def meet(mine: Path, other: Path, console: Console) -> None:
    """Ends well where another one runs at the same time."""
    mine.touch()
    if not appears(other):
        raise DataError("nobody came")


def appears(file: Path) -> bool:
    for _ in range(2000):
        if file.exists():
            return True
        time.sleep(0.01)
    return False


def test_everything_is_done_and_its_lines_have_its_name(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pieces = {name: partial(mark, tmp_path / name) for name in ("a", "b", "c")}
    assert sorted(at_once(pieces, 2)) == ["a", "b", "c"]
    assert all((tmp_path / name).exists() for name in pieces)
    assert {"b: made", "b: it"} <= set(capfd.readouterr().err.splitlines())


def test_as_many_as_asked_for_run_at_the_same_time(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    assert set(at_once({"1": partial(meet, one, other), "2": partial(meet, other, one)}, 2)) == {
        "1",
        "2",
    }


@pytest.mark.parametrize(
    ("work", "told"), [(fail, "bad: no data"), (die, "bad: its process ended with -9")]
)
def test_one_that_fails_is_told_of_and_the_others_end_as_by_ctrl_c(
    work: object, told: str, tmp_path: Path
) -> None:
    pieces = {"long": partial(train, tmp_path), "bad": work}
    with pytest.raises(DataError, match=told):
        list(at_once(pieces, 2))  # type: ignore[arg-type]
    assert (tmp_path / "saved").exists() or not (tmp_path / "begun").exists()
    assert not active_children()


def test_where_nobody_waits_any_more_what_runs_saves_and_ends(tmp_path: Path) -> None:
    pieces = {"long": partial(train, tmp_path), "short": partial(mark, tmp_path / "x")}
    working = at_once(pieces, 2)
    assert next(working) == "short"
    assert appears(tmp_path / "begun")
    working.close()  # as Ctrl-C does it
    assert (tmp_path / "saved").exists()
    assert not active_children()
