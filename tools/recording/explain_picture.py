"""One trigger as a picture: what each input had, when it came, and what the set took of it."""

from __future__ import annotations

from bisect import bisect_left

from pipeline.recording.explanation import (
    FIRED,
    Candidates,
    Explanation,
    InputStory,
    TriggerStory,
)
from tools.drawing.picture import Picture, text_width
from tools.drawing.plot import COLORS, GRID, INK, MUTED, ticks
from tools.recording.explain_table import outcome_of, sentence_of

WIDTH, ROW, TOP, MARGIN = 820.0, 46.0, 74.0, 18.0
BAND, WAIT, TAKEN, OTHER, MISSED = "#e0f2fe", "#fde68a", COLORS[2], "#94a3b8", COLORS[1]
#: Messages of one input that are drawn at most; a trajectory's would be a wall.
MOST = 60


def picture_of(explanation: Explanation, story: TriggerStory) -> Picture:
    """The time around a trigger, in ms from its stamp."""
    begin, end = _window(explanation, story)
    names = [f"{one.input} from {one.source.removesuffix('/out')}" for one in story.inputs]
    left = MARGIN + max(map(text_width, [*names, "waits, then runs"]), default=0.0) + 12
    title = f"{explanation.node.name}, trigger {story.seq} at {story.at_s:.3f} s"
    bottom = TOP + ROW * (1 + len(story.inputs))
    picture = Picture(title, left + WIDTH + MARGIN, bottom + 74)
    frame = _Frame(picture, left, begin, end)
    picture.text(MARGIN, 26, title, 15.0)
    picture.text(MARGIN, 48, f"{outcome_of(story)}; {sentence_of(story)}", 11.0, MUTED)
    for place, one in enumerate(story.inputs):
        if one.tolerance_ms is not None:
            frame.bar(-one.tolerance_ms, one.tolerance_ms, TOP + ROW * (place + 1) + 4, 38, BAND)
    _grid(frame, bottom)
    arrived = (story.arrived_s - story.at_s) * 1e3
    decided = end if story.decided_s is None else (story.decided_s - story.at_s) * 1e3
    frame.bar(arrived, decided, TOP + 14, 16, WAIT, sentence_of(story))
    frame.mark(0.0, TOP + 22, INK, f"stamp of trigger {story.seq}")
    frame.mark(arrived, TOP + 22, OTHER, "arrived", small=True)
    picture.text(MARGIN, TOP + 26, "waits, then runs" if story.outcome == FIRED else "waits")
    frame.rule(0.0, TOP, bottom, INK)
    frame.rule(decided, TOP, bottom, TAKEN if story.outcome == FIRED else MISSED)
    for place, one in enumerate(story.inputs):
        y = TOP + ROW * (place + 1)
        picture.text(MARGIN, y + 20, names[place])
        picture.text(left + 4, y + 40, f"{one.verdict} {one.why}", 9.0, MUTED)
        _messages(frame, explanation.candidates[place], story, one, y + 16, decided)
    _legend(picture, left, bottom + 54)
    return picture


class _Frame:
    """Milliseconds to places."""

    def __init__(self, picture: Picture, left: float, begin: float, end: float) -> None:
        self.picture = picture
        self.left = left
        self.begin = begin
        self.end = end

    def x(self, ms: float) -> float:
        inside = min(max(ms, self.begin), self.end)
        return self.left + WIDTH * (inside - self.begin) / (self.end - self.begin)

    def bar(
        self, first: float, last: float, y: float, height: float, color: str, title: str = ""
    ) -> None:
        x = self.x(first)
        self.picture.rectangle(x, y, max(self.x(last) - x, 1.0), height, color, title)

    def mark(self, ms: float, y: float, color: str, title: str, *, small: bool = False) -> None:
        if self.begin <= ms <= self.end:
            half = 2.5 if small else 5.0
            self.picture.rectangle(self.x(ms) - half, y - half, 2 * half, 2 * half, color, title)

    def rule(self, ms: float, y1: float, y2: float, color: str) -> None:
        self.picture.line(self.x(ms), y1, self.x(ms), y2, color)


def _messages(
    frame: _Frame,
    candidates: Candidates,
    story: TriggerStory,
    one: InputStory,
    y: float,
    decided: float,
) -> None:
    """Each message at its stamp, with a line to where it arrived."""
    first = bisect_left(candidates.stamps, story.stamp + round(frame.begin * 1e6))
    last = bisect_left(candidates.stamps, story.stamp + round(frame.end * 1e6))
    at = story.stamp / 1e6
    for place in range(first, last)[:MOST]:
        stamp = (candidates.stamps[place] - story.stamp) / 1e6
        came = candidates.arrivals[place] / 1e6 - at
        low, high = (one.used[0], one.used[-1]) if one.used else (1.0, 0.0)
        taken = low - 1e-6 <= stamp <= high + 1e-6
        color = TAKEN if taken else MISSED if came > decided else OTHER
        frame.picture.line(frame.x(stamp), y, frame.x(came), y, color)
        frame.mark(stamp, y, color, f"{stamp:+.1f} ms, arrived at {came:+.1f} ms")
        frame.mark(came, y, color, "arrived", small=True)


def _window(explanation: Explanation, story: TriggerStory) -> tuple[float, float]:
    """From before the tolerances to after the decision and the nearest messages."""
    ends = [0.0, (story.arrived_s - story.at_s) * 1e3]
    if story.decided_s is not None:
        ends.append((story.decided_s - story.at_s) * 1e3)
    for one in story.inputs:
        tolerance = one.tolerance_ms or 0.0
        ends += [-tolerance, tolerance, *one.used]
        if one.nearest_ms is not None and abs(one.nearest_ms) < 1_000:
            ends.append(one.nearest_ms)
            came = (one.nearest_came_ms or 0.0) + (story.arrived_s - story.at_s) * 1e3
            ends.append(min(came, max(ends) + 200))
    margin = 0.08 * (max(ends) - min(ends)) + 1.0
    return min(ends) - margin, max(ends) + margin


def _grid(frame: _Frame, bottom: float) -> None:
    step, _ = ticks(frame.end - frame.begin)
    number = int(frame.begin // step) + 1
    while number * step <= frame.end:
        frame.rule(number * step, TOP - 4, bottom, GRID)
        x = frame.x(number * step)
        frame.picture.text(x, bottom + 16, f"{number * step:g}", 11.0, MUTED, "middle")
        number += 1
    middle = frame.left + WIDTH / 2
    frame.picture.text(middle, bottom + 32, "ms from the trigger's stamp", 11.0, MUTED, "middle")


def _legend(picture: Picture, left: float, y: float) -> None:
    x = left
    for color, text in (
        (TAKEN, "taken"),
        (OTHER, "not taken"),
        (MISSED, "came after the decision"),
        (BAND, "tolerance"),
        (WAIT, "the trigger waits"),
    ):
        picture.rectangle(x, y, 10, 10, color)
        picture.text(x + 15, y + 9.5, text, 11.0, MUTED)
        x += 30 + text_width(text, 11.0)
    picture.text(x, y + 9.5, "line: from stamp to arrival", 11.0, MUTED)
