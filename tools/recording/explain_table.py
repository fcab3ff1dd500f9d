"""An explanation as a person reads it: why, how often, and what would be better."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.recording.clocks import Clock
from pipeline.recording.explanation import FIRED, OPEN, Explanation, TriggerStory
from pipeline.recording.tuning import Suggestion
from pipeline.scheduling.topology import Sync
from pipeline.scheduling.waits import Cause
from tools.watching.report import WHY

#: What a trigger waits for, in a newcomer's words; an edge stands for itself.
WAITS = {
    Cause.EARLIER: "an earlier trigger went first",
    Cause.RUNNING: "the run before was not over",
    Cause.NO_ROOM: "an output had no room",
    Cause.DEVICE_DOWN: "no device was up",
    Cause.DEVICE_BUSY: "the device was busy, its next run ready",
    Cause.TURN: "not yet its turn on the device",
    Cause.WORKER: "no CPU worker was free",
}
#: Verdicts by how well they are, and their colors.
VERDICTS = {
    "settled": "green",
    "unproven": "yellow",
    "held": "yellow",
    "nothing": "yellow",
    "late": "red",
    "silent": "red",
    "open": "dim",
}


def words_of(cause: str) -> str:
    """A cause of waiting for a person."""
    if "->" in cause:
        source, _, target = cause.partition("->")
        return f"{target.partition('/')[2]} from {source.removesuffix('/out')}"
    return WAITS[Cause(cause)]


def outcome_of(story: TriggerStory) -> str:
    """How a trigger ended, with the reason of a loss."""
    if story.outcome == FIRED:
        return f"run {story.run}"
    if story.outcome == OPEN:
        return "still waits at the end"
    return f"{story.outcome}: {WHY[story.outcome]}"


def sentence_of(story: TriggerStory) -> str:
    """The story of one trigger in a line."""
    parts = [f"{ms:.1f} ms {words_of(cause)}" for cause, ms in _longest(story.waits) if ms >= 0.05]
    waited = f"waited {story.waited_ms:.1f} ms"
    return f"{waited}: {', '.join(parts)}" if parts else waited


def print_summary(explanation: Explanation, console: Console) -> None:
    """How often what happened, for what it waited, and what the inputs brought."""
    stories = explanation.triggers
    node = explanation.node
    counts = Counter(story.outcome for story in stories)
    told = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
    console.print(f"[bold]{node.name}[/bold]: {len(stories)} triggers: {told}", highlight=False)
    for outcome in counts:
        if outcome in WHY:
            console.print(f"  {outcome}: {WHY[outcome]}", style="dim", highlight=False)
    console.print(_waits_table(stories))
    if explanation.candidates:
        console.print()
        console.print(_inputs_table(explanation))


def _waits_table(stories: Sequence[TriggerStory]) -> Table:
    table = _table("waited for", ["triggers", "median ms", "p99 ms", "share"])
    waited: dict[str, list[float]] = {}
    for story in stories:
        for cause, ms in story.waits.items():
            waited.setdefault(cause, []).append(ms)
    total = sum(map(sum, waited.values())) or 1.0
    for cause, times in sorted(waited.items(), key=lambda item: -sum(item[1])):
        share = f"{100 * sum(times) / total:.0f} %"
        table.add_row(words_of(cause), str(len(times)), *_quantiles(times), share)
    whole = [story.waited_ms for story in stories if story.decided_s is not None]
    table.add_row("in all", str(len(whole)), *_quantiles(whole), "", style="bold")
    return table


def _inputs_table(explanation: Explanation) -> Table:
    """How the sets found each input; verdicts that never occur have no column."""
    decided = [story for story in explanation.triggers if story.outcome != OPEN]
    counts = [
        Counter(story.inputs[place].verdict for story in decided)
        for place in range(len(explanation.candidates))
    ]
    shown = [verdict for verdict in VERDICTS if any(count[verdict] for count in counts)]
    table = _table("input", [*shown, "gap p50", "p99", "allowed ms"])
    for place, candidates in enumerate(explanation.candidates):
        gaps = [
            abs(one.nearest_ms)
            for one in (story.inputs[place] for story in decided)
            if one.nearest_ms is not None
        ]
        rule = candidates.rule
        table.add_row(
            f"{rule.name} from {str(candidates.port).removesuffix('/out')}",
            *(
                f"[{VERDICTS[verdict]}]{number}[/]" if number else ""
                for verdict in shown
                for number in [counts[place][verdict]]
            ),
            *_quantiles(gaps),
            f"{rule.tolerance / 1e6:g}" if rule.sync is Sync.NEAREST else str(rule.sync),
        )
    return table


def print_triggers(stories: Iterable[TriggerStory], console: Console) -> None:
    """A line for each trigger, and one for each input that is not as one would wish."""
    for story in stories:
        color = "green" if story.outcome == FIRED else "yellow"
        console.print(
            f"{story.at_s:9.3f} s  [{color}]{outcome_of(story)}[/], {sentence_of(story)}",
            highlight=False,
            soft_wrap=True,
        )
        for one in story.inputs:
            if one.verdict not in ("settled", "open"):
                _print_input(one.input, one.source, one.verdict, one.why, console)


def print_story(story: TriggerStory, console: Console) -> None:
    """One trigger, with all its inputs."""
    console.print(
        f"Trigger {story.seq} at {story.at_s:.3f} s (stamp {story.stamp} ns), arrived at "
        f"{story.arrived_s:.3f} s",
        highlight=False,
    )
    console.print(f"  {outcome_of(story)}, {sentence_of(story)}", highlight=False, soft_wrap=True)
    for one in story.inputs:
        _print_input(one.input, one.source, one.verdict, one.why, console)
        if one.nearest_came_ms is not None and one.sync == "nearest":
            side = "after" if one.nearest_came_ms >= 0 else "before"
            text = f"the nearest arrived {abs(one.nearest_came_ms):.1f} ms {side} the trigger"
            console.print(f"               {text}", style="dim", highlight=False)


def _print_input(name: str, source: str, verdict: str, why: str, console: Console) -> None:
    console.print(
        f"             {name} from {source.removesuffix('/out')}: "
        f"[{VERDICTS[verdict]}]{verdict}[/] {why}",
        highlight=False,
        soft_wrap=True,
    )


def print_clocks(clocks: Sequence[Clock], console: Console) -> None:
    """The streams as they were measured."""
    table = _table(
        "source", ["Hz", "period ms", "jitter", "gap", "offset", "delay", "p99", "drift ppm"]
    )
    for clock in clocks:
        values = (
            clock.rate_hz,
            clock.period_ms,
            clock.jitter_ms,
            clock.longest_gap_ms,
            clock.offset_ms,
            clock.delay_ms,
            clock.late_ms,
        )
        drift = "" if clock.drift_ppm is None else f"{clock.drift_ppm:+.0f}"
        table.add_row(
            clock.stream.removesuffix("/out"),
            *("" if value is None else f"{value:.1f}" for value in values),
            drift,
        )
    console.print(table)
    console.print(
        "jitter: 99 of 100 periods differ by less. offset: the least delay from stamp to arrival. "
        "drift: how fast that grows.",
        style="dim",
        highlight=False,
    )


def print_suggestions(found: Sequence[Suggestion], console: Console) -> None:
    """What the measured streams would have the file say."""
    for one in found:
        place = f"{one.input} from {one.source.removesuffix('/out')}"
        console.print(
            f"{place}: tolerance_ms {one.suggested_tolerance_ms:g} (now {one.tolerance_ms:g}), "
            f"offset_ms {one.suggested_offset_ms:g} (now {one.offset_ms:g}), max_wait_ms "
            f"{one.suggested_max_wait_ms:g} (now {one.max_wait_ms or 0:g})",
            highlight=False,
            soft_wrap=True,
        )
        console.print(f"  {one.why}", style="dim", highlight=False)


def _longest(waits: object) -> list[tuple[str, float]]:
    assert isinstance(waits, dict)
    return sorted(waits.items(), key=lambda item: -item[1])


def _quantiles(values: Sequence[float]) -> tuple[str, str]:
    if not values:
        return "", ""
    return f"{np.quantile(values, 0.5):.1f}", f"{np.quantile(values, 0.99):.1f}"


def _table(first: str, rest: Sequence[str]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(first, no_wrap=True)
    for title in rest:
        table.add_column(title, justify="right", no_wrap=True)
    return table
