"""A plain drawing of rectangles, lines and words, written as SVG or as PNG."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from tools.drawing.plot import FONT, INK, PAPER

#: Pixels of a PNG for each unit of the drawing: it stays sharp on a fine screen.
SCALE = 2
LETTER = 0.6  #: width of a letter over its size, generously
HERSHEY = cv2.FONT_HERSHEY_SIMPLEX
HERSHEY_PX = 30.0  #: size of HERSHEY's letters at scale 1, as fonts of SVG count it


class Rectangle(NamedTuple):
    """A filled rectangle."""

    x: float
    y: float
    width: float
    height: float
    color: str
    title: str  #: what SVG shows under the pointer


class Rule(NamedTuple):
    """A thin line."""

    x1: float
    y1: float
    x2: float
    y2: float
    color: str


class Words(NamedTuple):
    """A line of text."""

    x: float
    y: float  #: of the base line
    text: str
    size: float
    color: str
    anchor: str  #: start, middle or end


@dataclass(slots=True)
class Picture:
    """Shapes in the order in which they are laid over each other; colors as ``#rrggbb``."""

    title: str
    width: float
    height: float
    shapes: list[Rectangle | Rule | Words] = field(default_factory=list)

    def rectangle(
        self, x: float, y: float, width: float, height: float, color: str, title: str = ""
    ) -> None:
        self.shapes.append(Rectangle(x, y, width, height, color, title))

    def line(self, x1: float, y1: float, x2: float, y2: float, color: str) -> None:
        self.shapes.append(Rule(x1, y1, x2, y2, color))

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float = 12.0,
        color: str = INK,
        anchor: str = "start",
    ) -> None:
        self.shapes.append(Words(x, y, text, size, color, anchor))

    def svg(self) -> str:
        """The drawing as a page of its own."""
        body = "\n".join(map(_svg, self.shapes))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:.0f} '
            f'{self.height:.0f}" width="{self.width:.0f}" height="{self.height:.0f}" '
            f'font-family="{FONT}" role="img">\n<title>{escape(self.title)}</title>\n'
            f'<rect width="100%" height="100%" fill="{PAPER}"/>\n{body}\n</svg>\n'
        )

    def pixels(self) -> NDArray[np.uint8]:
        """(height, width, 3) BGR, `SCALE` times as large."""
        size = round(self.height * SCALE), round(self.width * SCALE), 3
        canvas = np.full(size, _bgr(PAPER), dtype=np.uint8)
        for shape in self.shapes:
            _draw(canvas, shape)
        return canvas


def write_picture(picture: Picture, path: Path) -> None:
    """Write the form that the ending names. Raises typer.BadParameter."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".svg":
            path.write_text(picture.svg())
        else:
            path.write_bytes(cv2.imencode(".png", picture.pixels())[1].tobytes())
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror}") from None


def text_width(text: str, size: float = 12.0) -> float:
    """A generous guess: no font can be asked here."""
    return len(text) * size * LETTER


def _svg(shape: Rectangle | Rule | Words) -> str:
    if isinstance(shape, Rectangle):
        title = f"<title>{escape(shape.title)}</title>" if shape.title else ""
        return (
            f'<rect x="{shape.x:.2f}" y="{shape.y:.1f}" width="{shape.width:.2f}" '
            f'height="{shape.height:.1f}" fill="{shape.color}">{title}</rect>'
        )
    if isinstance(shape, Rule):
        return (
            f'<line x1="{shape.x1:.1f}" y1="{shape.y1:.1f}" x2="{shape.x2:.1f}" '
            f'y2="{shape.y2:.1f}" stroke="{shape.color}"/>'
        )
    return (
        f'<text x="{shape.x:.1f}" y="{shape.y:.1f}" font-size="{shape.size:g}" '
        f'fill="{shape.color}" text-anchor="{shape.anchor}">{escape(shape.text)}</text>'
    )


def _draw(canvas: NDArray[np.uint8], shape: Rectangle | Rule | Words) -> None:
    color = _bgr(shape.color)
    if isinstance(shape, Rectangle):
        end = _pixel(shape.x + shape.width), _pixel(shape.y + shape.height)
        cv2.rectangle(canvas, (_pixel(shape.x), _pixel(shape.y)), end, color, cv2.FILLED)
    elif isinstance(shape, Rule):
        start, end = (_pixel(shape.x1), _pixel(shape.y1)), (_pixel(shape.x2), _pixel(shape.y2))
        cv2.line(canvas, start, end, color, 1, cv2.LINE_AA)
    else:
        size = shape.size * SCALE / HERSHEY_PX
        wide = cv2.getTextSize(shape.text, HERSHEY, size, 1)[0][0]
        left = {"start": 0.0, "middle": wide / 2, "end": wide}[shape.anchor]
        place = round(shape.x * SCALE - left), _pixel(shape.y)
        cv2.putText(canvas, shape.text, place, HERSHEY, size, color, 1, cv2.LINE_AA)


def _pixel(at: float) -> int:
    return round(at * SCALE)


def _bgr(color: str) -> tuple[int, int, int]:
    return int(color[5:7], 16), int(color[3:5], 16), int(color[1:3], 16)
