"""How far a run has come, told by when its sources end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from pipeline.drivers.course import Course
from pipeline.message import Message
from pipeline.stage import Source

S = 1_000_000_000


class Until(Source):
    """A source that says when it ends; None: that it does not know."""

    def __init__(self, last: int | None) -> None:
        self.last = last

    def messages(self) -> Iterator[Message[int]]:
        return iter(())

    def last_arrival(self) -> int | None:
        return self.last


class Broken(Until):
    """A source whose answer is a defect."""

    def last_arrival(self) -> int:
        raise ValueError("no index")


def course(sources: Mapping[str, Source], duration_s: float | None = None) -> Course:
    def tell(name: str, text: str) -> None:
        pytest.fail(f"{name}: {text}")

    return Course(sources, None, duration_s, tell)


@pytest.mark.parametrize(
    ("lasts", "duration_s", "after_10_s"),
    [
        ([50], None, 0.25),  # begun at 10 s: 40 s in all
        ([20, 50], None, 0.25),  # the last one to end
        ([None, 50], None, None),
        ([], None, None),
        ([None, 50], 20.0, 0.5),
        ([50], 100.0, 0.25),  # it ends before the duration is over
        ([50], 20.0, 0.5),
        ([10], None, None),  # nothing left from the first instant on
        ([15], None, 1.0),
    ],
)
def test_a_run_is_as_far_as_the_first_of_its_ends_says(
    lasts: list[int | None], duration_s: float | None, after_10_s: float | None
) -> None:
    sources = {str(k): Until(None if last is None else last * S) for k, last in enumerate(lasts)}
    run = course(sources, duration_s)
    assert run.done(10 * S) in (0.0, None)
    assert run.done(20 * S) == (None if after_10_s is None else pytest.approx(after_10_s))


def test_a_source_that_cannot_say_is_told_of_and_the_run_goes_on() -> None:
    told: list[Any] = []
    run = Course({"lidar": Broken(None)}, 0, None, lambda *words: told.append(words))
    assert told == [("lidar", "cannot say when its last message comes: no index")]
    assert run.done(0) is None
