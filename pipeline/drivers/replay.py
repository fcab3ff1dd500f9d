"""Re-enacts a recorded run: every decision as it was, every step for real, whatever the load.

The recorded events go into a fresh scheduler with their recorded times. A step that starts is
executed; the event that says it is over is brought when it really is. So the machine's speed
decides nothing: not which messages form a set, not what is dropped, not on which device a run goes.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any

from pipeline.drivers.executor import Worker
from pipeline.drivers.sealing import seal
from pipeline.errors import DataError
from pipeline.measuring.profiler import Profiler, Spent
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.recording.digest import digest_of
from pipeline.recording.flight import Event, Page
from pipeline.recording.outline import Outline
from pipeline.recording.payloads import Payloads
from pipeline.recording.reenactment import Reenactment
from pipeline.scheduling.events import Observer, Output, Start, Step
from pipeline.scheduling.topology import Port, Role, Topology

_Done = tuple[Sequence[Output], Spent]


class ReplayDriver:
    """Drives one process of a recorded run through all its events. Use once.

    The stages in `fed` are not executed: their recorded outputs are taken.
    """

    def __init__(
        self,
        topology: Topology,
        outline: Outline,
        workers: Mapping[str, Worker],
        payloads: Payloads,
        fed: Collection[str],
        statistics: Statistics,
        *,
        offline: bool,
        observer: Observer,
    ) -> None:
        self._topology = topology
        self._outline = outline
        self._workers = workers
        self._payloads = payloads
        senders = (node.name for node in topology.stages if node.role is Role.SENDER)
        self._fed = frozenset((*fed, *senders))  # nothing is sent again
        self._statistics = statistics
        self._profiler: Profiler = statistics.profiler
        self._running: dict[int, Future[_Done]] = {}
        self._hashes: dict[tuple[Port, int], str] = {}
        self._reenactment = Reenactment(
            topology, offline=offline, observer=observer, on_message=self._compare
        )
        self._stopped = False
        self.now = 0
        self.events = 0
        self.compared = 0
        self.different: list[str] = []  #: outputs that are not as recorded, the first ones
        self.differences = 0  #: all of them
        self.not_compared = 0  #: messages whose hash was not recorded

    @property
    def scheduler(self) -> Any:
        """The scheduler that decided again."""
        return self._reenactment.scheduler

    def stop(self) -> None:
        """Ask the replay to end after the event at hand: callable from a signal handler."""
        self._stopped = True

    def run(self, pages: Generator[Page], tick: Callable[[], None]) -> bool:
        """Bring all events; False where `stop` ended it. Raises Different, DataError."""
        threads = self._topology.workers + len(
            {d for s in self._topology.stages for d in s.devices}
        )
        enter = self._profiler.enter_thread
        with (
            closing(pages),
            closing(self._payloads),
            ThreadPoolExecutor(threads, "replay", enter) as pool,
        ):
            self._pool = pool
            try:
                for page in pages:
                    self._hashes.update(page.hashes)
                    for event in page.events:
                        if self._stopped:
                            return False
                        self._bring(event)
                        with self._profiler.showing():
                            tick()
            finally:
                self._profiler.read_threads()
        return True

    # ------------------------------------------------------------------ events

    def _bring(self, event: Event) -> None:
        self.now = event.now
        payload, outputs = None, None
        came = event.name in ("publish", "arrived")
        if came and event.followed and event.followed[0][0] == "out":
            payload = self._payloads.take(Port(*event.said[:2]), event.said[2]).payload
            seal(payload)
        elif event.name == "step_done":
            outputs = self._outputs(event)
        elif event.name == "step_failed":
            self._failed(event)
        for number, start in self._reenactment.step(event, payload, outputs):
            # A step that never came back, or took its device with it, is told and not done again.
            if start.run.stage not in self._fed and self._outline.came_back(number):
                self._running[number] = self._pool.submit(self._execute, start)
        self.events += 1

    def _outputs(self, event: Event) -> Sequence[Output]:
        number, said = event.said
        start = self._reenactment.running.get(number)
        if start is None:
            raise DataError(f"event {event.number} ends step {number}, which was not started")
        if start.run.stage in self._fed:
            return [self._recorded(start, *one) for one in said]
        future = self._running.pop(number)
        try:
            outputs, spent = future.result()
        except Exception as error:
            text = traceback.format_exc()
            stamp = start.run.inputs.trigger.stamp
            self._statistics.failed(start.run.stage, error, text, stamp, event.now)
            raise DataError(
                f"{start.run.stage} failed at stamp {stamp / 1e9:.6f} s, which it did not in the "
                f"flight: {type(error).__name__}: {error}"
            ) from error
        self._statistics.spent(start.run.stage, start.step, start.run.device, spent)
        return outputs

    def _recorded(
        self, start: Start, port: int, stamp: int | None, begin: int | None, end: int | None
    ) -> Output:
        """An output of a stage that is fed."""
        stage = start.run.stage
        at = start.run.inputs.trigger.stamp if stamp is None else stamp
        name = self._topology.stage(stage).outputs[port]
        message = self._payloads.take(Port(stage, name), at)
        return Output(port, message.payload, stamp, begin, end)

    def _failed(self, event: Event) -> None:
        """A recorded failure: the stage raises again, or it is told that it does not."""
        number = event.said[0]
        start = self._reenactment.running.get(number)
        future = self._running.pop(number, None)
        if start is None or future is None:
            return
        stage, stamp = start.run.stage, start.run.inputs.trigger.stamp
        error = future.exception()
        at = f"at stamp {stamp / 1e9:.6f} s"
        if error is not None:
            text = f"fails {at} as it did in the flight: {type(error).__name__}: {error}"
            self._statistics.event("failed_again", stage, text, event.now)
        else:
            text = f"failed {at} in the flight and does not fail here; taken as failed"
            self._statistics.event("not_repeated", stage, text, event.now)

    def _execute(self, start: Start) -> _Done:
        run = start.run
        before = self._profiler.read(run.device if start.step is Step.INFER else None)
        outputs = tuple(self._workers[run.stage].execute(run, start.step))
        return outputs, self._profiler.since(before)

    def _compare(self, port: Port, message: Message[Any]) -> None:
        """Hold a message that a port took against the recorded hash."""
        recorded = self._hashes.pop((port, message.seq), None)
        if recorded is None:
            self.not_compared += 1
            return
        self.compared += 1
        if digest_of(message.payload) == recorded:
            return
        self.differences += 1
        if len(self.different) < 10:
            kind = type(message.payload).__name__
            self.different.append(
                f"{port} at stamp {message.stamp / 1e9:.6f} s (message {message.seq}, {kind})"
            )
