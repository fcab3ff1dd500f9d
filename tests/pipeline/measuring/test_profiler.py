"""The profiler tells the truth: lines add up to the process, work is booked where it is done.

A loop of fixed length takes another time on every turn of a loaded or virtual machine, so no two
measured times are compared here. Whoever burns reads the clock of its thread around the work, and
what the profiler has booked for it is held against that reading: never less, and not much more.
What the process took beside is judged in halves of the work, as the process's clock may lag behind
those of threads that run on other cores by some milliseconds.
"""

from __future__ import annotations

import _thread
import gc
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from profiled_stages import burn, burn_ns

from accelerators.registry import Registry
from pipeline.drivers.run import run_graph
from pipeline.graph.graph import load_graph
from pipeline.measuring.cpu_clocks import thread_name, threads
from pipeline.measuring.profiler import Profiler
from pipeline.scheduling.events import Step

pytestmark = pytest.mark.skipif(not threads(), reason="needs the thread clocks of Linux")

LOOPS = 60_000


def profile(folder: Path, stages: dict[str, int], *, speed: float | None = 1.0) -> Any:
    """The report of stages that burn so many loops for each of the same messages."""
    lines = ["overflight: 1", "graph: burning", "stages:"]
    lines.append("  beat: {use: 'profiled_stages:Beat'}")
    for name, loops in stages.items():
        how = f"use: 'profiled_stages:Burn', options: {{loops: {loops}}}"
        rule = "{from: beat, queue: {policy: block, size: 20}}"
        lines.append(f"  {name}: {{{how}, inputs: {{x: {rule}}}}}")
    file = folder / "burning.yaml"
    file.write_text("\n".join(lines))
    catalog = Registry.open()
    result = run_graph(load_graph(file, catalog=catalog), catalog, speed=speed)
    assert not result.failures
    return result.report


def assert_booked_as_burnt(report: Any, stage: str) -> None:
    """What was booked for a stage is what it has read itself, and the little around it."""
    page = report["stages"][stage]
    booked_ms = page["runs"] * page["steps"]["cpu"]["process"]["cpu_ms"]["mean"]
    burnt_ms = page["statistics"]["burnt_ms"]
    assert 0.99 * burnt_ms < booked_ms < 1.5 * burnt_ms  # 0.99: the report rounds
    line_ms = report["cpu"]["of_stages_cores"][stage] * report["wall_s"] * 1e3
    assert line_ms == pytest.approx(booked_ms, rel=0.02)


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("speed", [1.0, None], ids=["live", "offline"])
def test_the_lines_add_up_to_the_clock_of_the_process(tmp_path: Path, speed: float | None) -> None:
    report = profile(tmp_path, {"one": 5 * LOOPS, "two": 10 * LOOPS}, speed=speed)
    cpu = report["cpu"]
    lines = [*cpu["of_stages_cores"].values(), *cpu["parts_cores"].values()]
    assert sum(lines) == pytest.approx(cpu["process_cores"], abs=1e-3)
    assert abs(cpu["parts_cores"]["unattributed"]) <= max(0.05 * cpu["process_cores"], 0.01)
    assert cpu["attributed"]


@pytest.mark.slow
@pytest.mark.realtime
def test_a_stage_is_booked_what_it_took_alone_and_beside_others(tmp_path: Path) -> None:
    # The clocks of threads do not run while they wait; a wall clock would say three times as much.
    assert_booked_as_burnt(profile(tmp_path, {"one": LOOPS}), "one")
    together = profile(tmp_path, {"one": LOOPS, "two": 2 * LOOPS, "four": 4 * LOOPS})
    for stage in ("one", "two", "four"):
        assert_booked_as_burnt(together, stage)


class Pool:
    """A native thread that burns when it is asked to, as a runtime's pool does."""

    def __init__(self) -> None:
        self._asked, self._done = threading.Semaphore(0), threading.Semaphore(0)
        self._over = False
        # Not a threading.Thread, which Python would know and the profiler take for somebody's own.
        _thread.start_new_thread(self._work, ())
        self.ask(1)

    def ask(self, loops: int) -> int:
        """Let it burn; what that took by its thread's clock, ns."""
        self._loops = loops
        self._asked.release()
        self._done.acquire()
        return self._burnt_ns

    def close(self) -> None:
        self._over = True
        self._asked.release()

    def _work(self) -> None:
        self.native_id = threading.get_native_id()
        while self._asked.acquire() and not self._over:
            self._burnt_ns = burn_ns(self._loops)
            self._done.release()


@pytest.fixture
def pool() -> Iterator[Callable[[], Pool]]:
    made: list[Pool] = []

    def make() -> Pool:
        made.append(Pool())
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_what_a_devices_pool_does_during_an_infer_is_that_infers(
    pool: Callable[[], Pool],
) -> None:
    with Profiler() as profiler:
        with profiler.building("gpu"):
            native = pool()
        profiler.start(["gpu"])
        before = profiler.read("gpu")
        burnt = native.ask(20 * LOOPS)
        inferred = profiler.since(before)
        profiler.book("net", Step.INFER, "gpu", inferred)
        before = profiler.read()
        burnt_after = burn_ns(LOOPS)
        finished = profiler.since(before)
        profiler.book("net", Step.FINISH, "gpu", finished)
        cpu = profiler.stop(0)
    assert burnt <= inferred.cpu_ns - inferred.own_ns < 1.5 * burnt
    assert inferred.own_ns < burnt / 2  # the caller only waited
    assert burnt_after <= finished.cpu_ns == finished.own_ns < burnt_after + burnt / 2
    assert profiler.costs["net"]["gpu", Step.FINISH].cpu_ns == finished.cpu_ns
    assert cpu.stages["net"] >= inferred.cpu_ns + finished.cpu_ns
    assert not cpu.shared
    assert abs(cpu.unattributed) < burnt / 2  # neither lost nor counted twice


def test_a_pool_that_two_devices_use_is_a_line_of_its_own(pool: Callable[[], Pool]) -> None:
    with Profiler() as profiler:
        with profiler.building("gpu"):
            native = pool()
        with profiler.building("cpu"):
            native.ask(LOOPS)
        profiler.start(["gpu", "cpu"])
        before = profiler.read("gpu")
        burnt = native.ask(20 * LOOPS)
        spent = profiler.since(before)
        profiler.book("net", Step.INFER, "gpu", spent)
        cpu = profiler.stop(0)
    assert list(cpu.shared) == ["threads of cpu and gpu"]
    assert cpu.shared["threads of cpu and gpu"] >= burnt
    assert spent.cpu_ns == spent.own_ns < burnt / 2
    assert abs(cpu.unattributed) < burnt / 2


def test_a_pool_that_works_between_infers_of_two_stages_is_split_by_none(
    pool: Callable[[], Pool],
) -> None:
    with Profiler() as profiler:
        with profiler.building("gpu"):
            native = pool()
        profiler.start(["gpu"])
        for stage in ("a", "b"):
            profiler.book(stage, Step.INFER, "gpu", profiler.since(profiler.read("gpu")))
        burnt = native.ask(20 * LOOPS)
        cpu = profiler.stop(0)
    assert cpu.shared["gpu between its runs"] >= burnt
    assert max(cpu.stages.values()) < burnt / 2


def test_a_device_that_is_built_anew_during_the_run_keeps_what_it_took(
    pool: Callable[[], Pool],
) -> None:
    with Profiler() as profiler:
        with profiler.building("gpu"):
            old = pool()
        profiler.start(["gpu"])
        before = profiler.read("gpu")
        burnt_first = old.ask(20 * LOOPS)
        first = profiler.since(before)
        profiler.book("net", Step.INFER, "gpu", first)
        with profiler.building("gpu"):
            new = pool()
        before = profiler.read("gpu")
        burnt_second = new.ask(20 * LOOPS)
        second = profiler.since(before)
        profiler.book("net", Step.INFER, "gpu", second)
        cpu = profiler.stop(0)
    assert first.cpu_ns - first.own_ns >= burnt_first
    assert second.cpu_ns - second.own_ns >= burnt_second
    assert cpu.stages["net"] >= first.cpu_ns + second.cpu_ns
    assert abs(cpu.unattributed) < burnt_first / 2


def test_threads_that_a_stage_starts_when_it_opens_are_the_stages(
    pool: Callable[[], Pool],
) -> None:
    with Profiler() as profiler:
        with profiler.building("map"):
            writer = pool()
        profiler.start([])
        burnt = writer.ask(20 * LOOPS)
        cpu = profiler.stop(0)
    assert cpu.stages["map"] >= burnt
    assert abs(cpu.unattributed) < burnt / 2


def test_a_thread_that_nobody_owns_stays_unattributed_and_is_named(
    pool: Callable[[], Pool],
) -> None:
    with Profiler() as profiler:
        profiler.start([])
        stranger = pool()
        burnt = stranger.ask(20 * LOOPS)
        cpu = profiler.stop(0)
    assert cpu.unattributed > burnt / 2
    assert sum(cpu.strangers.values()) >= burnt


def test_collecting_garbage_within_a_step_is_not_the_steps() -> None:
    with Profiler() as profiler:
        profiler.start([])
        for _ in range(20_000):
            cycle: list[Any] = []
            cycle.append(cycle)
        before = profiler.read()
        gc.collect()
        profiler.book("litter", Step.PROCESS, None, profiler.since(before))
        cpu = profiler.stop(0)
    assert cpu.collector > cpu.stages["litter"] > 0


def test_the_callback_of_the_collector_goes_with_the_profiler() -> None:
    before = list(gc.callbacks)

    def fail() -> None:
        with Profiler() as profiler:
            profiler.start([])
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert gc.callbacks == before


def test_what_shows_the_run_is_neither_a_stages_nor_the_drivers() -> None:
    with Profiler() as profiler:
        profiler.start([])
        with profiler.showing():
            burnt = burn_ns(20 * LOOPS)
        cpu = profiler.stop(0)
    assert cpu.progress >= burnt
    assert cpu.drivers < burnt / 2
    assert not cpu.stages


def test_the_scheduler_is_never_said_to_take_more_than_there_is() -> None:
    with Profiler() as profiler:
        profiler.start([])
        cpu = profiler.stop(scheduler_ns=10**12)
    assert cpu.drivers == 0
    assert cpu.unattributed < 10**9


def test_what_a_thread_of_the_framework_took_before_the_run_is_none_of_it() -> None:
    """The control and receiving threads of a part are there while it opens."""
    profiler = Profiler()
    ready, go = threading.Event(), threading.Event()
    burnt: list[int] = []

    def work() -> None:
        with profiler.thread("control"):
            burnt.append(burn_ns(20 * LOOPS))
            ready.set()
            go.wait()

    with profiler:
        thread = threading.Thread(target=work)
        thread.start()
        ready.wait()
        profiler.start(())
        go.set()
        thread.join()
        cpu = profiler.stop(0)
    assert cpu.drivers < burnt[0] / 2
    assert cpu.unattributed > -burnt[0] / 2


def test_the_frameworks_threads_are_counted_after_they_have_ended() -> None:
    with Profiler() as profiler:
        profiler.start([])
        burnt: list[int] = []

        def work() -> None:
            with profiler.thread("cpu-0"):
                burnt.append(burn_ns(20 * LOOPS))

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        cpu = profiler.stop(0)
    assert cpu.drivers >= burnt[0]
    assert abs(cpu.unattributed) < burnt[0] / 2


def test_top_shows_the_names_of_the_frameworks_threads() -> None:
    names = []

    def work() -> None:
        with Profiler().thread("dev-edgetpu"):
            names.append(thread_name(threading.get_native_id()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert names == ["dev-edgetpu"]


def test_top_shows_whose_a_runtimes_threads_are(pool: Callable[[], Pool]) -> None:
    with Profiler() as profiler:
        with profiler.building("igpu"):
            native = pool().native_id
        profiler.start(["igpu"])
        assert thread_name(native) == "of-igpu"


class Moved:
    """A device process whose clock the test sets."""

    pid = 1


def test_an_isolated_device_infers_in_its_process_and_the_caller_transfers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [0]
    monkeypatch.setattr("pipeline.measuring.cpu_clocks.process_ns", lambda pid: clock[0])
    with Profiler() as profiler:
        with profiler.building("tpu", Moved()):
            pass
        profiler.start(["tpu"])
        before = profiler.read("tpu")
        clock[0] += 40_000_000
        burn(LOOPS)
        spent = profiler.since(before)
        profiler.book("net", Step.INFER, "tpu", spent)
        clock[0] += 1_000_000  # what the process does after its answer
        cpu = profiler.stop(0)
    assert spent.cpu_ns == 40_000_000
    assert 0 < spent.transfer_ns == spent.own_ns
    assert cpu.processes == {"tpu": 41_000_000}
    assert cpu.stages["net"] == 41_000_000 + spent.transfer_ns
    assert profiler.costs["net"]["tpu", Step.INFER].cpu_ns == 41_000_000


def test_a_step_without_work_takes_wall_time_and_no_cpu() -> None:
    profiler = Profiler()
    before = profiler.read()
    threading.Event().wait(0.05)
    spent = profiler.since(before)
    assert spent.wall_ns >= 50_000_000
    assert spent.cpu_ns < spent.wall_ns / 4
