"""The ground: a grid of streets with kerbs and sidewalks, and what the blocks between are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stages.simulation.materials import Material
from stages.simulation.mesh import Array, Mesh, Surface
from stages.simulation.things import Things

ROAD_M = 9.0  #: between the kerbs: two lanes and a parking lane on either side
SIDEWALK_M = 2.6
KERB_M = 0.12  #: height of a kerb, and of every block's ground

_STREET = (0.105, 0.105, 0.11)


@dataclass(frozen=True, slots=True)
class Block:
    """A rectangle between streets, from kerb to kerb."""

    low: tuple[float, float]
    high: tuple[float, float]

    def side(self, k: int) -> tuple[Array, Array, float]:
        """Corner, direction along (unit) and length of side k, counterclockwise from the south."""
        (x0, y0), (x1, y1) = self.low, self.high
        corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        along = corners[(k + 1) % 4] - corners[k]
        length = float(np.linalg.norm(along))
        return corners[k], along / length, length


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The middles of the streets."""

    xs: Array  #: of those that run along y
    ys: Array

    @classmethod
    def draw(cls, random: np.random.Generator, blocks: int) -> Grid:
        """`blocks` x `blocks` blocks of 44 to 60 m about the origin."""
        lines = []
        for _ in range(2):
            at = np.concatenate([[0.0], np.cumsum(random.uniform(44.0, 60.0, blocks) + ROAD_M)])
            lines.append(at - at.mean())
        return cls(*lines)

    def blocks(self) -> list[Block]:
        """All blocks, row by row."""
        half = ROAD_M / 2
        return [
            Block((x0 + half, y0 + half), (x1 - half, y1 - half))
            for y0, y1 in pairwise(self.ys)
            for x0, x1 in pairwise(self.xs)
        ]


def lay_streets(still: Mesh, things: Things, grid: Grid) -> None:
    """Asphalt between the blocks, with markings and zebra crossings."""
    road = things.new("road")
    half = ROAD_M / 2
    for x in grid.xs:
        for y in grid.ys:
            _rectangle(still, road, Surface(Material.ASPHALT, _STREET), x, y, half, half, 0.0)
    for x in grid.xs:
        for y0, y1 in pairwise(grid.ys):
            _street(still, road, (x, y0 + half), (x, y1 - half))
    for y in grid.ys:
        for x0, x1 in pairwise(grid.xs):
            _street(still, road, (x0 + half, y), (x1 - half, y))
    # What lies beyond the district, so that no ray falls off the world's edge.
    beyond = things.new("vegetation")
    meadow = Surface(Material.LAWN, (0.11, 0.15, 0.045))
    x0, x1, y0, y1 = grid.xs[0], grid.xs[-1], grid.ys[0], grid.ys[-1]
    wide = 400.0
    for low, high in (
        ((x0 - wide, y0 - wide), (x1 + wide, y0 - half)),
        ((x0 - wide, y1 + half), (x1 + wide, y1 + wide)),
        ((x0 - wide, y0 - half), (x0 - half, y1 + half)),
        ((x1 + half, y0 - half), (x1 + wide, y1 + half)),
    ):
        cx, cy = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
        _rectangle(still, beyond, meadow, cx, cy, high[0] - cx, high[1] - cy, 0.0)


def pave_block(still: Mesh, things: Things, block: Block, ground: Surface, class_name: str) -> None:
    """Kerb and sidewalk around a block, and `ground` within."""
    sidewalk = things.new("sidewalk")
    paving = Surface(Material.PAVING, (0.36, 0.35, 0.33))
    kerb = Surface(Material.KERB, (0.46, 0.45, 0.43))
    (x0, y0), (x1, y1) = block.low, block.high
    ring = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    still.prism(sidewalk, kerb, ring, 0.0, KERB_M, top=False)
    inward = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    edges = [ring + inward * width for width in (0.0, 0.16, SIDEWALK_M)]
    for outer, inner, surface in ((edges[0], edges[1], kerb), (edges[1], edges[2], paving)):
        for k in range(4):
            n = (k + 1) % 4
            corners = np.array([outer[k], outer[n], inner[n], inner[k]])
            still.quad(sidewalk, surface, np.column_stack([corners, np.full(4, KERB_M)]))
    inside = things.new(class_name)
    still.quad(inside, ground, np.column_stack([edges[2], np.full(4, KERB_M)]))


def _street(still: Mesh, road: int, start: tuple[float, float], stop: tuple[float, float]) -> None:
    """A segment between two crossings, with a zebra before either."""
    a, b = np.array(start), np.array(stop)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    left = np.array([-along[1], along[0]])
    half = ROAD_M / 2

    def strip(surface: Surface, first: float, last: float, width: float, z: float) -> None:
        ring = [
            a + along * s + left * side
            for s, side in ((first, -width), (last, -width), (last, width), (first, width))
        ]
        still.quad(road, surface, np.column_stack([np.array(ring), np.full(4, z)]))

    strip(Surface(Material.STREET, _STREET, (length, ROAD_M)), 0.0, length, half, 0.0)
    for first in (1.2, length - 4.2):
        zebra = Surface(Material.ZEBRA, _STREET, (3.0, 2 * half - 0.6))
        strip(zebra, first, first + 3.0, half - 0.3, 0.006)


def _rectangle(
    still: Mesh, thing: int, surface: Surface, x: float, y: float, dx: float, dy: float, z: float
) -> None:
    still.quad(
        thing,
        surface,
        [(x - dx, y - dy, z), (x + dx, y - dy, z), (x + dx, y + dy, z), (x - dx, y + dy, z)],
    )
