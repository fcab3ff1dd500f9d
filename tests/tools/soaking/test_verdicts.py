from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import pytest

from tools.soaking.verdicts import Verdict, growth, sentence, verdicts
from tools.soaking.watch import Kill, Life, Reading, Watch

BALANCED = {"ledger_balanced": True}


def well() -> Watch:
    """A run of 60 s with one kill, in which all is as it should be."""
    watch = Watch(os.getpid(), {"a/out": "main", "b/out": "far"})
    watch.look(page(1, 1), 100.0)
    watch.began(100.0)
    for second in range(61):
        watch.look(page(1 + second, 1 + second), 100.0 + second)
    watch.lives = {
        7: Life("main", 0, 200.0, 203.0, 40, 40, 60),
        8: Life("far", 0, 100.0, 103.0, 30, 30, 30),
        9: Life("far", 33, 101.0, 103.0, 30, 30, 60),
    }
    watch.kills = [Kill("far", 30.0, {"b/out": 30}, 8, {"b/out": 2.5})]
    watch.readings = [Reading(at, 60.0, 20, 4, 30.0) for at in range(0, 60, 5)]
    return watch


def page(a: int, b: int) -> dict[str, Any]:
    return {
        "processes": {"main": {"pid": None}, "far": {"pid": None}},
        "outputs": {"a/out": {"count": a}, "b/out": {"count": b}},
    }


def not_met(watch: Watch, report: dict[str, Any] = BALANCED, code: int | None = 0) -> list[str]:
    return [verdict.what for verdict in verdicts(watch, report, code) if not verdict.met]


def test_a_run_that_is_well_meets_every_bound() -> None:
    assert not_met(well()) == []
    assert "p50 2.50 s, p95 2.50 s" in [v.measured for v in verdicts(well(), BALANCED, 0)]


@pytest.mark.parametrize("code", [1, None])
def test_a_run_that_failed_or_lost_its_books_is_not_well(code: int | None) -> None:
    assert not_met(well(), {}, code) == ["the run", "ledger across all lives"]


def test_a_silence_of_more_than_five_seconds_is_named() -> None:
    watch = well()
    watch.look(page(100, 61), 165.5)
    watch.look(page(101, 61), 166.5)
    [found] = [v for v in verdicts(watch, BALANCED, 0) if not v.met]
    assert found == Verdict("longest silence of an output", "6.5 s (b/out)", "<= 5 s", False)


def test_what_grows_is_found_life_by_life_and_reading_by_reading() -> None:
    watch = well()
    for pid in range(10, 16):  # of six starts the last three hold more
        mb, descriptors = (150.0, 60) if pid > 12 else (100.0, 30)
        watch.lives[pid] = Life("far", 10.0 * pid + 10, mb, mb, descriptors, descriptors, 200)
    watch.readings += [Reading(60 + at, 90.0, 30, 12, 130.0) for at in range(12)]
    assert not_met(watch) == [
        "far: memory of 6 starts after 120 s, each 10 s old: growth",
        "far: descriptors: growth",
        "supervisor: memory: growth",
        "supervisor: descriptors: growth",
        "files in /dev/shm: growth",
        "in /dev/shm: growth",
    ]


def test_a_process_that_comes_back_late_or_never_is_found() -> None:
    watch = well()
    watch.kills.append(Kill("far", 40.0, {"b/out": 40}, 9, {"b/out": 5.5}))
    assert not_met(watch) == ["kill to first new output (2 kills)"]
    watch.kills = [Kill("far", 40.0, {"b/out": 40}, 9)]
    assert not_met(watch) == ["kills survived"]


def test_files_that_stay_behind_are_found() -> None:
    watch = well()
    watch.left_files = ["overflight-run-1-2-ab"]
    assert not_met(watch) == ["files left in /dev/shm"]


def test_nothing_read_is_not_taken_for_no_growth() -> None:
    watch = well()
    watch.readings = []
    assert "files in /dev/shm: growth" in not_met(watch)


def test_memory_is_not_judged_while_the_map_fills() -> None:
    watch = well()
    for pid in range(10, 16):
        watch.lives[pid] = Life("far", 10.0 * pid - 60, 100.0 + 9 * pid, 200.0, 30, 30, 100)
    assert not_met(watch) == []
    told = [v.measured for v in verdicts(watch, BALANCED, 0) if v.what.startswith("far: memory")]
    assert told == ["too short to tell: 3 starts are needed"]


def test_the_last_sentence_names_what_is_not_met() -> None:
    assert sentence(verdicts(well(), BALANCED, 0)) == "Every bound is met."
    judged = verdicts(well(), {}, 0)
    assert sentence(judged) == f"Not met (1 of {len(judged)}): ledger across all lives."


def test_growth_is_that_of_the_middle_of_the_last_third() -> None:
    assert growth([1, 1, 50, 1, 1, 1, 9, 3, 3]) == 2


def test_a_kill_is_a_kill_and_its_outputs_are_back_once_they_count_again() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    watch = Watch(os.getpid(), {"a/out": "main", "b/out": "far"})
    shown = page(5, 5)
    shown["processes"]["far"]["pid"] = child.pid
    watch.look(shown, 1.0)
    assert watch.flows
    watch.began(1.0)
    watch.kill("far", 2.0)
    assert child.wait(60) == -9
    shown = page(9, 7)  # made before it was killed, told after it
    watch.look(shown, 2.5)
    shown["processes"]["far"]["pid"] = os.getpid()
    watch.look(shown, 3.0)
    assert not watch.all_back
    shown["outputs"]["b/out"]["count"] = 8
    watch.look(shown, 4.5)
    assert watch.all_back
    assert watch.kills[0].first_s == watch.kills[0].all_s == 2.5
