"""`overflight explain`: why a stage of a recorded flight ran when it did, and on what."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from pipeline.errors import DataError
from pipeline.recording.clocks import Clock, clock_of
from pipeline.recording.explanation import FIRED, Explanation, TriggerStory, explain
from pipeline.recording.flight import Flight
from pipeline.recording.tuning import Suggestion, suggestions
from tools.drawing.picture import write_picture
from tools.recording.explain_picture import picture_of
from tools.recording.explain_table import (
    print_clocks,
    print_story,
    print_suggestions,
    print_summary,
    print_triggers,
)
from tools.recording.several import file_of_stage

#: Triggers that are listed without --all: those that waited longest or found something missing.
LISTED = 12


def explain_file(
    path: Path,
    stage: str,
    *,
    at_s: float | None = None,
    all_triggers: bool = False,
    picture: Path | None = None,
    as_json: bool = False,
) -> None:
    """Explain a stage, or one trigger of it. Raises DataError."""
    flight = Flight(file_of_stage(path, stage))
    _check_stage(flight, stage)
    console = Console()
    with Console(stderr=True).status("stepping the scheduler through the flight ..."):
        explanation = explain(flight, stage)
    if not explanation.triggers:
        raise DataError(f"{flight.path}: nothing ever came to the trigger of {stage}")
    if explanation.gap is not None:
        Console(stderr=True).print(f"Only the beginning: {explanation.gap}", style="yellow")
    chosen = _chosen(explanation, at_s)
    if at_s is not None:
        _tell_if_beyond(explanation, at_s)
    clocks = [clock_of(name, *times) for name, times in explanation.streams.items()]
    found = suggestions(explanation)
    if picture is not None:
        write_picture(picture_of(explanation, chosen), picture)
    if as_json:
        only = [chosen] if at_s is not None else list(explanation.triggers)
        typer.echo(json.dumps(_page(explanation, only, clocks, found), indent=2))
        return
    if at_s is not None:
        print_story(chosen, console)
    else:
        print_summary(explanation, console)
        console.print()
        _list(explanation, console, all_triggers=all_triggers)
        console.print()
        print_clocks(clocks, console)
        if found:
            console.print("\nAs these streams were measured:")
            print_suggestions(found, console)
    if picture is not None:
        console.print(f"Written: {picture}", highlight=False)


def _check_stage(flight: Flight, stage: str) -> None:
    nodes = {node.name: node for node in flight.manifest.topology.stages}
    if stage not in nodes:
        close = get_close_matches(stage, nodes, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(nodes)}"
        raise DataError(f"{flight.path}: no stage '{stage}'; {hint}")
    if nodes[stage].is_source:
        users = [
            node.name
            for node in nodes.values()
            if any(port.stage == stage for rule in node.inputs for port in rule.sources)
        ]
        raise DataError(
            f"{stage} is a source: nothing is decided there; ask of {' or '.join(users)}"
        )


def _tell_if_beyond(explanation: Explanation, at_s: float) -> None:
    """Say so where the time lies over a second before the first trigger or after the last."""
    stamps = [story.at_s for story in explanation.triggers]
    first, last = min(stamps), max(stamps)
    if first - 1.0 <= at_s <= last + 1.0:
        return
    Console(stderr=True).print(
        f"Nothing triggers {explanation.node.name} at {at_s:g} s: its triggers are stamped "
        f"{first:.3f} to {last:.3f} s. This is the nearest.",
        style="yellow",
        highlight=False,
    )


def _chosen(explanation: Explanation, at_s: float | None) -> TriggerStory:
    """The trigger nearest to a time, by default the most telling one."""
    if at_s is None:
        return _telling(explanation.triggers, 1)[0]
    return min(explanation.triggers, key=lambda story: abs(story.at_s - at_s))


def _telling(stories: Sequence[TriggerStory], count: int) -> list[TriggerStory]:
    """Those with the most to tell: something missing first, then the longest waits."""

    def tells(story: TriggerStory) -> tuple[int, float]:
        odd = sum(one.verdict not in ("settled", "open") for one in story.inputs)
        return odd, story.waited_ms

    fired = [story for story in stories if story.outcome == FIRED] or list(stories)
    return sorted(sorted(fired, key=tells)[-count:], key=lambda story: story.at_s)


def _list(explanation: Explanation, console: Console, *, all_triggers: bool) -> None:
    stories = explanation.triggers
    if all_triggers or len(stories) <= LISTED:
        print_triggers(stories, console)
        return
    told = _telling(stories, LISTED)
    console.print(
        f"The {len(told)} of {len(stories)} that tell most (--all lists every one, --at SECONDS "
        "explains one):",
        highlight=False,
    )
    print_triggers(told, console)


def _page(
    explanation: Explanation,
    stories: Sequence[TriggerStory],
    clocks: Sequence[Clock],
    found: Sequence[Suggestion],
) -> dict[str, Any]:
    return {
        "stage": explanation.node.name,
        "begin_ns": explanation.begin,
        "gap": explanation.gap,
        "outcomes": dict(Counter(story.outcome for story in explanation.triggers)),
        "triggers": [asdict(story) for story in stories],
        "clocks": [asdict(clock) for clock in clocks],
        "suggestions": [asdict(one) for one in found],
    }
