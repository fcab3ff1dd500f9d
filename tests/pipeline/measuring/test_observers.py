from __future__ import annotations

from pipeline.measuring.observers import observed_by
from pipeline.scheduling.events import Observer


class Listens(Observer):
    """Keeps the events it is told of, in a list that it may share."""

    def __init__(self, heard: list[tuple[str, str]], name: str) -> None:
        self._heard = heard
        self._name = name

    def event(self, kind: str, subject: str, text: str, now: int) -> None:
        self._heard.append((self._name, kind))


def test_a_single_observer_is_called_without_anything_between() -> None:
    alone = Listens([], "a")
    assert observed_by(alone) is alone


def test_all_are_told_in_their_order() -> None:
    heard: list[tuple[str, str]] = []
    both = observed_by(Listens(heard, "a"), Observer(), Listens(heard, "b"))
    both.event("stale", "edge", "", 0)
    assert heard == [("a", "stale"), ("b", "stale")]


def test_several_may_be_one_of_several() -> None:
    heard: list[tuple[str, str]] = []
    inner = observed_by(Listens(heard, "a"), Listens(heard, "b"))
    observed_by(inner, Listens(heard, "c")).event("stale", "edge", "", 0)
    assert heard == [("a", "stale"), ("b", "stale"), ("c", "stale")]


def test_a_call_that_one_alone_listens_to_goes_straight_to_it() -> None:
    listens = Listens([], "a")
    assert observed_by(Observer(), listens).event == listens.event


def test_every_call_of_an_observer_is_passed_on() -> None:
    told: list[str] = []
    calls = [name for name in vars(Observer) if not name.startswith("_")]

    def note(name: str):  # type: ignore[no-untyped-def]
        return lambda self, *arguments: told.append(name)

    listening = type("All", (Observer,), {name: note(name) for name in calls})
    both = observed_by(listening(), listening())
    for name in calls:
        arguments = range(getattr(Observer, name).__code__.co_argcount - 1)
        getattr(both, name)(*arguments)
    assert told == [name for name in calls for _ in range(2)]
