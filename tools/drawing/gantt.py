"""Draws a schedule: a line for each device and each stage, a bar for each step."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.drivers.plan import Bar
from pipeline.scheduling.topology import Topology
from tools.drawing.picture import Picture, text_width
from tools.drawing.plot import COLORS, GRID, INK, MUTED, PAPER, ticks

WIDTH, ROW, BAR, GAP = 900.0, 22.0, 15.0, 10.0
TOP, MARGIN = 46.0, 16.0


def gantt(
    bars: Sequence[Bar], topology: Topology, shown_s: tuple[float, float], title: str
) -> Picture:
    """The part `shown_s` of a schedule; each stage keeps its color on all lines.

    Devices stand at the top, with the infer steps; below them the steps of stages on the CPU.
    """
    begin, end = (second * 1e9 for second in shown_s)
    devices = list(dict.fromkeys(bar.device for bar in bars if bar.device is not None))
    busy = {bar.stage for bar in bars if bar.end > bar.begin}
    stages = [node.name for node in topology.stages if node.name in busy]
    color = {name: COLORS[place % len(COLORS)] for place, name in enumerate(stages)}
    y_of: dict[tuple[str, str], float] = {}
    for place, device in enumerate(sorted(devices)):
        y_of["device", device] = TOP + ROW * place
    cpu_top = TOP + ROW * len(devices) + GAP
    for place, name in enumerate(stages):
        y_of["stage", name] = cpu_top + ROW * place
    left = MARGIN + max((text_width(name) for _, name in y_of), default=0.0) + 26
    bottom = cpu_top + ROW * len(stages)
    picture = Picture(title, left + WIDTH + MARGIN, bottom + 46)
    picture.text(MARGIN, 24, title, 14.0)
    _grid(picture, left, bottom, (end - begin) / 1e6)
    for (kind, name), y in y_of.items():
        picture.text(left - 24, y + 12, name, color=INK, anchor="end")
        if kind == "stage":
            picture.rectangle(left - 18, y + 3, 9, 9, color[name])
    for bar in bars:
        first, last = max(bar.begin, begin), min(bar.end, end)
        if last <= first:
            continue
        row = ("device", bar.device) if bar.device is not None else ("stage", bar.stage)
        x, wide = left + WIDTH * (first - begin) / (end - begin), WIDTH * (last - first)
        wide = max(wide / (end - begin) - 1.0, 0.5)  # a hairline between two that touch
        took = f"{bar.stage} {bar.step}, {(bar.end - bar.begin) / 1e6:.1f} ms"
        y = y_of[row[0], str(row[1])]
        picture.rectangle(x, y, wide, BAR, color[bar.stage], took)
        if bar.device is not None and wide > text_width(bar.stage, 9.0):
            picture.text(x + wide / 2, y + 11.5, bar.stage, 10.0, PAPER, "middle")
    return picture


def _grid(picture: Picture, left: float, bottom: float, length_ms: float) -> None:
    step, _ = ticks(length_ms)
    for number in range(int(length_ms / step + 1e-9) + 1):
        x = left + WIDTH * number * step / length_ms
        picture.line(x, TOP - 6, x, bottom, GRID)
        picture.text(x, bottom + 16, f"{number * step:g}", 11.0, MUTED, "middle")
    picture.text(left + WIDTH / 2, bottom + 34, "ms", 11.0, MUTED, "middle")
