"""Lets several observers watch one scheduler, without a cost where only one listens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.scheduling.events import Observer

_CALLS = ("published", "refused", "dropped", "set_formed", "run_ended", "event")


def observed_by(*observers: Observer) -> Observer:
    """One observer for all of these, told in their order; a single one is returned as it is."""
    return observers[0] if len(observers) == 1 else _Several(observers)


class _Several(Observer):
    """Passes each call on to those that override it; straight to it where that is only one."""

    def __init__(self, observers: tuple[Observer, ...]) -> None:
        for call in _CALLS:
            base = getattr(Observer, call)
            each_told = [getattr(each, call) for each in observers]
            # One of several observers has its calls of its own, not of its class.
            told = [one for one in each_told if getattr(one, "__func__", None) is not base]
            if told:
                setattr(self, call, told[0] if len(told) == 1 else _all_of(told))


def _all_of(told: list[Callable[..., None]]) -> Callable[..., None]:
    def tell(*arguments: Any) -> None:
        for call in told:
            call(*arguments)

    return tell
