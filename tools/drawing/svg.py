"""Draws a graph as SVG: stages in columns by depth, colored by the device they prefer."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from xml.sax.saxutils import escape

from pipeline.scheduling.topology import Sync
from tools.drawing.diagram import Box, Diagram
from tools.drawing.layout import Layout, Link, arrange

FONT = "ui-sans-serif, system-ui, 'Segoe UI', Helvetica, Arial, sans-serif"
NAME_PX, TEXT_PX = 13.0, 11.0
HEADER, ROW, PAD = 26.0, 17.0, 9.0
GAP_Y, GAP_X, MARGIN = 20.0, 58.0, 20.0
BOLD = 1.15  #: how much wider bold letters are

INK, MUTED, LINE, PAPER, CARD = "#0f172a", "#64748b", "#94a3b8", "#ffffff", "#f8fafc"
SENSOR, PLAIN = "#334155", "#64748b"
LOAD = "#fbbf24"
NO_LOADS: Mapping[str, float] = {}
#: One per device in the order of the file; readable with white text, also without red and green.
DEVICES = ("#0f766e", "#4f46e5", "#b45309", "#be185d", "#0369a1", "#6d28d9")


def svg(diagram: Diagram, loads: Mapping[str, float] = NO_LOADS) -> str:
    """The whole picture, on white so that it reads on a dark page too.

    `loads` are percent of a core by stage: written into its box, and drawn as a bar.
    """
    heights = {box.name: _height(box) for box in diagram.boxes}
    boxes = {box.name: box for box in diagram.boxes}
    links = [
        Link(
            arrow.source,
            arrow.target,
            _port_y(boxes[arrow.source], arrow.port),
            _socket_y(boxes[arrow.target], arrow.input),
        )
        for arrow in diagram.arrows
    ]
    layout = arrange(heights, links, GAP_Y)
    lefts, widths = _columns(diagram, layout, loads)
    devices = list(dict.fromkeys(device for box in diagram.boxes for device in box.devices))
    colors = dict(zip(devices, DEVICES * (1 + len(devices) // len(DEVICES)), strict=False))

    body: list[str] = []
    for arrow, link, bends in zip(diagram.arrows, links, layout.bends, strict=True):
        start = layout.column[link.source]
        points = [(lefts[start] + widths[start], MARGIN + layout.top[link.source] + link.leaves)]
        for skipped, y in enumerate(bends, start + 1):
            points += [(lefts[skipped], MARGIN + y), (lefts[skipped] + widths[skipped], MARGIN + y)]
        end = layout.column[link.target]
        points.append((lefts[end], MARGIN + layout.top[link.target] + link.enters))
        body.append(_curve(points, arrow.sync))
    for box in diagram.boxes:
        place = layout.column[box.name]
        body.append(
            _box(
                box, lefts[place], MARGIN + layout.top[box.name], widths[place], _color(box, colors)
            )
        )
        if (load := loads.get(box.name)) is not None:
            body.append(_load(lefts[place], MARGIN + layout.top[box.name], widths[place], load))
    width = lefts[-1] + widths[-1] + MARGIN if lefts else 2 * MARGIN
    lows = [layout.top[name] + heights[name] for name in heights]
    bottom = max([*lows, *(y for bends in layout.bends for y in bends)], default=0.0) + MARGIN
    body.append(_legend(colors, MARGIN, bottom + 22))
    height = bottom + 22 + MARGIN
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
            f'width="{width:.0f}" height="{height:.0f}" font-family="{FONT}" '
            f'font-size="{TEXT_PX:g}" role="img">',
            f"<title>{escape(diagram.name)}</title>",
            f'<rect width="100%" height="100%" rx="8" fill="{PAPER}"/>',
            *body,
            "</svg>",
        ]
    )


def _color(box: Box, colors: dict[str, str]) -> str:
    if box.devices:
        return colors[box.devices[0]]
    return PLAIN if box.inputs else SENSOR


def _rows(box: Box) -> int:
    return (1 if box.devices else 0) + max(len(box.inputs), len(_named_ports(box)))


def _height(box: Box) -> float:
    return HEADER + (_rows(box) * ROW + 8.0 if _rows(box) else 0.0)


def _named_ports(box: Box) -> tuple[str, ...]:
    """Output ports that need a name: a single `out` goes without saying."""
    return () if box.outputs == ("out",) else box.outputs


def _row_y(box: Box, row: int) -> float:
    return HEADER + 4.0 + ROW * (row + (1 if box.devices else 0)) + ROW / 2


def _socket_y(box: Box, name: str) -> float:
    return _row_y(box, [socket.name for socket in box.inputs].index(name))


def _port_y(box: Box, name: str) -> float:
    named = _named_ports(box)
    return _row_y(box, named.index(name)) if named else HEADER / 2


def _text_width(text: str, size: float) -> float:
    """A generous guess: no font can be asked here."""
    return len(text) * size * 0.6


def _columns(
    diagram: Diagram, layout: Layout, loads: Mapping[str, float]
) -> tuple[list[float], list[float]]:
    """The left edge and the width of every column."""
    widths = [0.0] * (max(layout.column.values(), default=-1) + 1)
    for box in diagram.boxes:
        wide = _text_width(box.name, NAME_PX) * BOLD
        wide += _text_width("100.0 %", TEXT_PX) if box.name in loads else 0.0
        wide = max(wide, _text_width(" → ".join(box.devices), TEXT_PX) * BOLD)
        ports = _named_ports(box)
        for row, socket in enumerate(box.inputs):
            text = f"{socket.name}   {socket.rule}" if socket.rule else socket.name
            text += f"      {ports[row]}" if row < len(ports) else ""
            wide = max(wide, _text_width(text, TEXT_PX))
        for port in ports[len(box.inputs) :]:
            wide = max(wide, _text_width(port, TEXT_PX))
        column = layout.column[box.name]
        widths[column] = max(widths[column], wide + 2 * PAD)
    lefts = []
    left = MARGIN
    for width in widths:
        lefts.append(left)
        left += width + GAP_X
    return lefts, widths


def _curve(points: list[tuple[float, float]], sync: str) -> str:
    path = f"M{points[0][0]:.1f} {points[0][1]:.1f}"
    for (x0, y0), (x1, y1) in pairwise(points):
        bend = (x1 - x0) / 2
        path += f" C{x0 + bend:.1f} {y0:.1f} {x1 - bend:.1f} {y1:.1f} {x1:.1f} {y1:.1f}"
    dash = "" if sync == Sync.TRIGGER else ' stroke-dasharray="5 4"'
    return f'<path d="{path}" fill="none" stroke="{LINE}" stroke-width="1.6"{dash}/>'


def _box(box: Box, x: float, y: float, width: float, color: str) -> str:
    height = _height(box)
    parts = [
        f"<g><title>{escape(box.use)}</title>",
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="6" '
        f'fill="{CARD}" stroke="{color}" stroke-width="1.2"/>',
        _header(x, y, width, color, whole=height == HEADER),
        _text(x + PAD, y + HEADER / 2, box.name, "#ffffff", size=NAME_PX, bold=True),
    ]
    if box.devices:
        parts.append(
            _text(x + PAD, y + HEADER + 4 + ROW / 2, " → ".join(box.devices), color, bold=True)
        )
    for socket in box.inputs:
        middle = y + _socket_y(box, socket.name)
        fill = color if socket.sync == Sync.TRIGGER else PAPER
        parts.append(
            f'<circle cx="{x:.1f}" cy="{middle:.1f}" r="3.5" fill="{fill}" stroke="{color}" '
            f'stroke-width="1.4"/>'
        )
        rule = f'<tspan fill="{MUTED}" dx="6">{escape(socket.rule)}</tspan>' if socket.rule else ""
        parts.append(_text(x + PAD, middle, socket.name, INK, after=rule))
    for port in _named_ports(box):
        parts.append(_text(x + width - PAD, y + _port_y(box, port), port, INK, anchor="end"))
    return "\n".join([*parts, "</g>"])


def _load(x: float, y: float, width: float, percent: float) -> str:
    """A load in the header, and as a bar under it that is full at one core."""
    bar = width * min(max(percent, 0.0), 100.0) / 100
    return "\n".join(
        [
            _text(x + width - PAD, y + HEADER / 2, f"{percent:.1f} %", "#ffffff", anchor="end"),
            f'<rect x="{x:.1f}" y="{y + HEADER - 4:.1f}" width="{bar:.1f}" height="4" '
            f'fill="{LOAD}"/>',
        ]
    )


def _header(x: float, y: float, width: float, color: str, whole: bool) -> str:
    """The band with the name: round at the top, and at the bottom too where nothing follows."""
    if whole:
        return (
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{HEADER}" rx="6" '
            f'fill="{color}"/>'
        )
    return (
        f'<path d="M{x:.1f} {y + HEADER:.1f} v{6 - HEADER} a6 6 0 0 1 6 -6 h{width - 12:.1f} '
        f'a6 6 0 0 1 6 6 v{HEADER - 6} z" fill="{color}"/>'
    )


def _text(
    x: float,
    y: float,
    text: str,
    fill: str,
    *,
    size: float = TEXT_PX,
    bold: bool = False,
    anchor: str = "start",
    after: str = "",
) -> str:
    weight = ' font-weight="600"' if bold else ""
    end = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return (
        f'<text x="{x:.1f}" y="{y + size * 0.35:.1f}" font-size="{size:g}" fill="{fill}"'
        f"{weight}{end}>{escape(text)}{after}</text>"
    )


def _legend(colors: dict[str, str], x: float, y: float) -> str:
    parts = []
    for name, color in {"sensor": SENSOR, "stage": PLAIN, **colors}.items():
        parts.append(
            f'<rect x="{x:.1f}" y="{y - 5:.1f}" width="10" height="10" rx="2" fill="{color}"/>'
        )
        parts.append(_text(x + 15, y, name, MUTED))
        x += 15 + _text_width(name, TEXT_PX) + 16
    for name, sync in (("trigger", Sync.TRIGGER), ("synchronized", Sync.NEAREST)):
        parts.append(_curve([(x, y), (x + 26, y)], sync))
        parts.append(_text(x + 31, y, name, MUTED))
        x += 31 + _text_width(name, TEXT_PX) + 16
    return "\n".join(parts)
