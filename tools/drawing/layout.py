"""Where the boxes of a graph stand: columns by depth, few crossings, edges as straight as can be.

The layered method (Sugiyama, Tagawa and Toda 1981): an edge that skips columns gets a waypoint in
each; columns are ordered by the mean place of their neighbours; then heights are fitted to the
neighbours' under that order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

#: Enough for graphs of some dozen stages; more changes nothing that one sees.
SWEEPS = 12


@dataclass(frozen=True, slots=True)
class Link:
    """An edge and where it touches its boxes, measured from their tops."""

    source: str
    target: str
    leaves: float
    enters: float


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns, heights and waypoints."""

    column: Mapping[str, int]  #: 0 is the leftmost
    top: Mapping[str, float]  #: the upper edge of each box
    bends: Sequence[Sequence[float]]  #: per link, its height in each column that it skips


def arrange(heights: Mapping[str, float], links: Sequence[Link], gap: float) -> Layout:
    """Lay out boxes of these heights, at least `gap` apart; the links must have no cycle."""
    column = _columns(list(heights), links)
    size = dict(heights)
    chains: list[list[str]] = []  # per link: source, waypoints, target
    for number, link in enumerate(links):
        skipped = range(column[link.source] + 1, column[link.target])
        waypoints = [f"{number}@{place}" for place in skipped]
        size |= dict.fromkeys(waypoints, 0.0)
        column |= dict(zip(waypoints, skipped, strict=True))
        chains.append([link.source, *waypoints, link.target])

    # Per node, what it hangs on to its left and right: (neighbour, wanted top relative to its top).
    left: dict[str, list[tuple[str, float]]] = {name: [] for name in size}
    right: dict[str, list[tuple[str, float]]] = {name: [] for name in size}
    for link, chain in zip(links, chains, strict=True):
        touch = [link.leaves, *[0.0] * (len(chain) - 2), link.enters]
        for i in range(len(chain) - 1):
            right[chain[i]].append((chain[i + 1], touch[i + 1] - touch[i]))
            left[chain[i + 1]].append((chain[i], touch[i] - touch[i + 1]))

    layers: list[list[str]] = [[] for _ in range(max(column.values(), default=0) + 1)]
    for name in size:
        layers[column[name]].append(name)
    top = dict.fromkeys(size, 0.0)
    for layer in layers:
        _fit(layer, [0.0] * len(layer), size, gap, top)
    for sweep in range(2 * SWEEPS):
        forward = sweep % 2 == 0
        reorder = sweep < SWEEPS
        for layer in layers if forward else reversed(layers):
            wanted = {}
            for name in layer:
                hold = (left if forward else right)[name] if reorder else left[name] + right[name]
                places = [top[other] + offset for other, offset in hold]
                wanted[name] = sum(places) / len(places) if places else top[name]
            if reorder:
                layer.sort(key=lambda name: wanted[name] + size[name] / 2)
            _fit(layer, [wanted[name] for name in layer], size, gap, top)
    highest = min(top.values(), default=0.0)
    top = {name: y - highest for name, y in top.items()}
    return Layout(
        {name: column[name] for name in heights},
        {name: top[name] for name in heights},
        [[top[waypoint] for waypoint in chain[1:-1]] for chain in chains],
    )


def _columns(names: Sequence[str], links: Sequence[Link]) -> dict[str, int]:
    """The longest path from a source to each box."""
    column = dict.fromkeys(names, 0)
    for _ in names:
        for link in links:
            column[link.target] = max(column[link.target], column[link.source] + 1)
    return column


def _fit(
    layer: Sequence[str],
    wanted: Sequence[float],
    size: Mapping[str, float],
    gap: float,
    top: dict[str, float],
) -> None:
    """Set the tops nearest to those wanted (least squares) that keep the order and the gap.

    With the room that all boxes above need subtracted, this is isotonic regression, solved by
    pooling adjacent violators.
    """
    pools: list[tuple[float, list[tuple[str, float]]]] = []  # mean place, (name, room above it)
    room = 0.0
    for name, place in zip(layer, wanted, strict=True):
        mean, members = place - room, [(name, room)]
        while pools and pools[-1][0] > mean:
            before, earlier = pools.pop()
            total = before * len(earlier) + mean * len(members)
            members = earlier + members
            mean = total / len(members)
        pools.append((mean, members))
        room += size[name] + gap
    for mean, members in pools:
        for name, above in members:
            top[name] = mean + above
