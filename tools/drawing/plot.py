"""Two plots as SVG, enough for a profile: lines over a number, and stacked horizontal bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

FONT = "ui-sans-serif, system-ui, 'Segoe UI', Helvetica, Arial, sans-serif"
INK, MUTED, GRID, PAPER = "#0f172a", "#64748b", "#e2e8f0", "#ffffff"
#: Okabe and Ito's palette, which color-blind people can tell apart; black is left to the text.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a7d00")
TEXT_PX = 12.0
LETTER = 0.58  #: width of a letter over its height, generously


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a plot. Lines of one `color` belong together, as a model on two devices."""

    name: str
    points: Sequence[tuple[float, float]]
    color: int = 0
    dashed: bool = False


def line_plot(lines: Sequence[Line], x_label: str, y_label: str, note: str = "") -> str:
    """Both axes begin at 0; the names stand to the right, a note below."""
    names = max((len(line.name) for line in lines), default=0) * TEXT_PX * LETTER
    left, top, width, height = 62.0, 16.0, 520.0, 300.0
    whole = left + width + 56 + names, top + height + (76 if note else 52)
    x_step, x_end = ticks(max((x for line in lines for x, _ in line.points), default=1.0))
    y_step, y_end = ticks(max((y for line in lines for _, y in line.points), default=1.0))
    body = [_text(left, top + height + 64, note, MUTED)] if note else []
    for at in _steps(y_step, y_end):
        y = top + height * (1 - at / y_end)
        body.append(_rule(left, y, left + width, y))
        body.append(_text(left - 8, y + 4, f"{at:g}", MUTED, "end"))
    for at in _steps(x_step, x_end):
        x = left + width * at / x_end
        body.append(_rule(x, top, x, top + height))
        body.append(_text(x, top + height + 18, f"{at:g}", MUTED, "middle"))
    body.append(_text(left + width / 2, top + height + 40, x_label, INK, "middle"))
    middle = top + height / 2
    label = _text(16, middle, y_label, INK, "middle")
    body.append(f'<g transform="rotate(-90 16 {middle:.1f})">{label}</g>')
    for number, line in enumerate(lines):
        color = COLORS[line.color % len(COLORS)]
        dash = ' stroke-dasharray="6 4"' if line.dashed else ""
        places = [
            (left + width * x / x_end, top + height * (1 - y / y_end)) for x, y in line.points
        ]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        body.append(
            f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"{dash}/>'
        )
        body += [_mark(x, y, color, line.dashed) for x, y in places]
        y = top + 10 + 20 * number
        x = left + width + 16
        body.append(
            f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{x + 26:.1f}" y2="{y:.1f}" stroke="{color}" '
            f'stroke-width="2"{dash}/>'
        )
        body.append(_mark(x + 13, y, color, line.dashed))
        body.append(_text(x + 32, y + 4, line.name))
    whole = whole[0], max(whole[1], top + 20 * len(lines) + 20)
    return _picture(*whole, body, f"{y_label} over {x_label}")


def bar_plot(
    rows: Sequence[tuple[str, Mapping[str, float]]], unit: str, order: Sequence[str] = ()
) -> str:
    """One bar per row, stacked of parts that keep their colors; its sum is written behind it.

    `order`: parts that may occur, whose colors are the same in every plot that names them so.
    """
    found = dict.fromkeys(part for _, row in rows for part in row)
    known = list(dict.fromkeys([*order, *found]))
    colors = {part: COLORS[place % len(COLORS)] for place, part in enumerate(known)}
    parts = [part for part in known if part in found]
    left = max((len(name) for name, _ in rows), default=0) * TEXT_PX * LETTER + 14
    width, bar, gap, top = 520.0, 16.0, 8.0, 34.0
    step, end = ticks(max((sum(row.values()) for _, row in rows), default=1.0))
    bottom = top + len(rows) * (bar + gap)
    body = []
    x = left
    for part in parts:
        body.append(f'<rect x="{x:.1f}" y="6" width="11" height="11" fill="{colors[part]}"/>')
        body.append(_text(x + 16, 16, part, MUTED))
        x += 16 + len(part) * TEXT_PX * LETTER + 16
    for at in _steps(step, end):
        x_at = left + width * at / end
        body.append(_rule(x_at, top - 6, x_at, bottom))
        body.append(_text(x_at, bottom + 14, f"{at:g}", MUTED, "middle"))
    body.append(_text(left + width / 2, bottom + 32, unit, INK, "middle"))
    for number, (name, row) in enumerate(rows):
        y = top + number * (bar + gap)
        body.append(_text(left - 8, y + 12, name, INK, "end"))
        x_at = left
        for part, value in row.items():
            wide = width * max(value, 0.0) / end
            body.append(
                f'<rect x="{x_at:.2f}" y="{y:.1f}" width="{wide:.2f}" height="{bar}" '
                f'fill="{colors[part]}"><title>{escape(part)}: {value:.2f}</title></rect>'
            )
            x_at += wide
        body.append(_text(x_at + 6, y + 12, f"{sum(row.values()):.1f}", MUTED))
    return _picture(max(left + width + 50, x), bottom + 44, body, unit)


def ticks(most: float) -> tuple[float, float]:
    """The distance of round ticks, at most seven of them, and the end of the axis."""
    if not most > 0:
        return 1.0, 1.0
    size = 10 ** math.floor(math.log10(most / 6))
    step = next(size * factor for factor in (1, 2, 5, 10, 20) if most / (size * factor) <= 6)
    return step, step * math.ceil(most / step - 1e-9)


def _steps(step: float, end: float) -> list[float]:
    return [number * step for number in range(round(end / step) + 1)]


def _mark(x: float, y: float, color: str, dashed: bool) -> str:
    """A point; a dashed line's is a wider ring, seen around another at the same place."""
    radius, fill = (5.5, "none") if dashed else (3.5, color)
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{color}" '
        'stroke-width="1.5"/>'
    )


def _rule(x1: float, y1: float, x2: float, y2: float) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{GRID}" '
        'stroke-width="1"/>'
    )


def _text(x: float, y: float, text: str, fill: str = INK, anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{fill}" text-anchor="{anchor}">{escape(text)}</text>'
    )


def _picture(width: float, height: float, body: Sequence[str], title: str) -> str:
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
            f'width="{width:.0f}" height="{height:.0f}" font-family="{FONT}" '
            f'font-size="{TEXT_PX:g}" role="img">',
            f"<title>{escape(title)}</title>",
            f'<rect width="100%" height="100%" fill="{PAPER}"/>',
            *body,
            "</svg>",
        ]
    )
