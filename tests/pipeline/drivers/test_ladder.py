"""The ladder in flight: devices that raise, hang and return, on real threads.

The source waits where the stage is late, and a flight that waits for a device goes on until that is
back: so a busy machine makes these flights longer, and no other.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from driving import MS, Ran, beat, drive

from pipeline.errors import DeviceError
from pipeline.measuring.statistics import Statistics
from pipeline.message import Message
from pipeline.model import ModelSpec, Tensor, Tensors
from pipeline.scheduling.ledger import balanced
from pipeline.scheduling.topology import Input, OnError, Policy, Port, StageNode
from pipeline.stage import ModelStage, Stage

pytestmark = pytest.mark.realtime


class Network:
    """A model that answers its device's number, or does what `fault` does at this run."""

    spec = ModelSpec("net", "x", (1, 1, 1), "float32", "")

    def __init__(self, number: int, fault: Callable[[int], None] = lambda run: None) -> None:
        self.number, self.fault, self.runs = number, fault, 0

    def encode(self, tensors: Tensors) -> Mapping[str, Any]:
        return {}

    def infer(self, native: Mapping[str, Any]) -> Mapping[str, Any]:
        self.runs += 1
        time.sleep(0.002)
        self.fault(self.runs)
        return {"device": np.array([self.number])}

    def decode(self, native: Mapping[str, Any]) -> Tensors:
        return {name: Tensor(array) for name, array in native.items()}


class Infer(ModelStage):
    """Says which device made its result."""

    def prepare(self, x: Message[int]) -> Tensors:
        return {}

    def finish(self, outputs: Tensors, x: Message[int]) -> int:
        return int(outputs["device"].array[0])


class Keep(Stage):
    """A sink that keeps the messages."""

    def __init__(self) -> None:
        self.messages: list[Message[int]] = []

    def process(self, x: Message[int]) -> None:
        self.messages.append(x)


def fly(
    *networks: Network,
    count: int = 60,
    until: Callable[[Sequence[int], Statistics], bool] | None = None,
    check: Callable[[str], None] = lambda device: None,
    check_every_ms: int = 100,
    during: Callable[[Any], None] | None = None,
    timeout_ms: int = 60_000,
    **rules: Any,
) -> tuple[list[Message[int]], Ran]:
    """`count` frames at 100 Hz through one stage with these networks on its ladder, or as many as
    it takes `until` the results so far, and what was told, are so.

    A run that takes `timeout_ms` hangs: by itself the scheduler would say so after 100 ms here, and
    so long a thread of a busy machine may stand still.
    """
    names = [f"rung{network.number}" for network in networks]
    nodes: Sequence[StageNode] = [
        StageNode("source"),
        StageNode(
            "infer",
            (Input("x", (Port("source"),), policy=Policy.BLOCK, size=2),),
            devices=tuple(names),
            max_in_flight=2,
            on_error=OnError.SKIP,
            timeout=timeout_ms * MS,
            **rules,
        ),
        StageNode("sink", (Input("x", (Port("infer"),), policy=Policy.BLOCK, size=9),), ()),
    ]
    sink = Keep()

    def tick(driver: Any) -> None:
        if during is not None:
            during(driver)
        payloads = [message.payload for message in sink.messages]
        if until is not None and until(payloads, driver._statistics):
            driver.stop()

    ran = drive(
        nodes,
        {"infer": Infer(), "sink": sink},
        {"source": beat(count if until is None else 6_000, 10)},
        live=True,
        models={"infer": dict(zip(names, networks, strict=True))},
        check=check,
        check_every_ms=check_every_ms,
        during=tick,
    )
    assert balanced(ran.ledger)
    return sink.messages, ran


def kinds(ran: Ran) -> list[tuple[str, str]]:
    return [(event.kind, event.subject) for event in ran.statistics.events]


def times_ms(statistics: Statistics, kind: str) -> list[float]:
    """When events of a kind were told."""
    return [event.at_ns / MS for event in statistics.events if event.kind == kind]


def gaps_ms(messages: Sequence[Message[int]]) -> float:
    """The longest time without a result."""
    times = [message.received for message in messages]
    return max(b - a for a, b in itertools.pairwise(times)) / MS


def turns(payloads: Sequence[int]) -> list[int]:
    """The devices in the order in which they took over."""
    return [device for device, _ in itertools.groupby(payloads)]


def is_back(payloads: Sequence[int], statistics: Statistics) -> bool:
    return turns(payloads) == [1, 2, 1]


def raises(*runs: int) -> Callable[[int], None]:
    def fault(run: int) -> None:
        if run in runs:
            raise DeviceError("the device is gone")

    return fault


def test_a_device_that_raises_loses_no_frame_and_the_run_goes_on_below() -> None:
    messages, ran = fly(Network(1, raises(10)), Network(2), check_every_ms=10_000)
    assert [message.payload for message in messages] == [1] * 9 + [2] * 51
    assert ran.ledger["source/out->infer/x"]["delivered"] == len(messages)
    assert ran.statistics.failures == []
    assert gaps_ms(messages) < 5_000  # it did not wait for the device
    assert ("device_down", "rung1") in kinds(ran)


def test_results_say_which_device_made_them_and_whether_it_was_the_second_choice() -> None:
    messages, _ = fly(Network(1, raises(10)), Network(2), check_every_ms=10_000)
    assert {(m.executor, m.degraded) for m in messages if m.payload == 1} == {("rung1", False)}
    assert {(m.executor, m.degraded) for m in messages if m.payload == 2} == {("rung2", True)}


def test_a_device_that_works_again_is_climbed_back_to() -> None:
    _, ran = fly(Network(1, raises(10)), Network(2), until=is_back)
    assert kinds(ran).index(("device_down", "rung1")) < kinds(ran).index(("device_up", "rung1"))


def test_a_device_that_is_still_lost_is_asked_again_and_not_climbed_to() -> None:
    asked: list[str] = []

    def check(device: str) -> None:
        asked.append(device)
        if len(asked) < 3:
            raise DeviceError("not there yet")

    messages, ran = fly(
        Network(1, raises(5)), Network(2), until=is_back, check=check, check_every_ms=80
    )
    assert asked == ["rung1"] * 3
    assert kinds(ran).count(("device_check", "rung1")) == 2
    (down,) = times_ms(ran.statistics, "device_down")
    (up,) = times_ms(ran.statistics, "device_up")
    assert up - down >= 3 * 80
    assert turns([message.payload for message in messages]) == [1, 2, 1]


def test_a_device_that_flaps_is_left_alone_longer_each_time() -> None:
    network = Network(1)
    network.fault = raises(*range(5, 100))  # the check passes, the next run fails

    def four_times(_: Sequence[int], statistics: Statistics) -> bool:
        return len(times_ms(statistics, "device_down")) >= 4

    _, ran = fly(network, Network(2), until=four_times, check_every_ms=100)
    downs = times_ms(ran.statistics, "device_down")
    pauses = [b - a for a, b in itertools.pairwise(downs)]
    assert all(pause >= 100 * 2**n for n, pause in enumerate(pauses))


def test_a_device_that_hangs_costs_one_timeout_and_its_late_answer_is_ignored() -> None:
    release = threading.Event()

    def hang(run: int) -> None:
        if run == 10:
            release.wait(30)

    def during(driver: Any) -> None:
        if times_ms(driver._statistics, "device_hung"):
            release.set()

    messages, ran = fly(
        Network(1, hang),
        Network(2),
        timeout_ms=3_000,
        count=80,
        during=during,
        check_every_ms=30_000,
    )
    stamps = [message.stamp for message in messages]
    assert stamps == sorted(set(stamps))
    assert 3_000 <= gaps_ms(messages) < 6_000  # one timeout, and not two
    assert [message.payload for message in messages] == [1] * 9 + [2] * 71
    assert ("device_hung", "rung1") in kinds(ran)


def test_a_run_without_another_rung_fails_and_the_stage_waits_for_its_device() -> None:
    messages, ran = fly(Network(1, raises(10)), check_every_ms=100)
    assert ran.runs["infer"]["failed"] == 1
    assert "the device is gone" in ran.statistics.failures[0]
    assert ran.runs["infer"]["abandoned"] <= 1  # the next one, when it was between its steps
    assert [m.payload for m in messages] == [1] * (59 - ran.runs["infer"]["abandoned"])
    assert gaps_ms(messages) > 80


def test_on_a_lower_rung_a_stage_keeps_its_rate_cap() -> None:
    messages, ran = fly(
        Network(1, raises(10)), Network(2), check_every_ms=10_000, degraded_period=50 * MS
    )
    degraded = [m.stamp for m in messages if m.degraded]
    assert len(degraded) >= 6
    # The first is the run that failed; one more may have been in flight, chosen before.
    assert all(b - a >= 45 * MS for a, b in itertools.pairwise(degraded[1:]))
    assert ran.ledger["source/out->infer/x"]["dropped"]["decimated"] >= 30
