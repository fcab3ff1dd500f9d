"""Collects the mistakes and warnings of a graph file, each with its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pipeline.errors import GraphError, Mistake
from pipeline.graph.nodes import Mark, Node, Steps


class Report:
    """What is wrong with a graph file, in the words of that file."""

    def __init__(self) -> None:
        self._mistakes: list[tuple[Mark, Mistake]] = []
        self._warnings: list[tuple[Mark, Mistake]] = []
        self.tree: Node | None = None  #: the merged file, once there is one
        self.paths: dict[int, Path] = {}  #: where each path of an option leads, by `id` of its node

    def mistake_at(self, mark: Mark, what: str, steps: Steps = ()) -> None:
        """A mistake whose place is known."""
        entry = (mark, _mistake(mark, spelled(steps), what))
        if entry not in self._mistakes:
            self._mistakes.append(entry)

    def mistake(self, steps: Steps, what: str, *, at_key: bool = False) -> None:
        """A mistake in the value at `steps` of the merged file, or in its key."""
        assert self.tree is not None
        if not self.tree.find(steps)[0].broken:
            self._mistakes.append(self._placed(steps, what, at_key))

    def warn(self, steps: Steps, what: str) -> None:
        """Something that can run and that the author should know."""
        self._warnings.append(self._placed(steps, what, False))

    def has(self, steps: Steps) -> bool:
        """Whether the merged file holds something at `steps`."""
        return self.tree is not None and self.tree.get(*steps) is not None

    def entries(self, steps: Steps) -> Mapping[str, Node]:
        """The mapping at `steps` of the merged file; empty where there is none."""
        node = self.tree.get(*steps) if self.tree is not None else None
        return node.entries() if node is not None else {}

    @property
    def warnings(self) -> tuple[Mistake, ...]:
        """All warnings, in the order of the files."""
        return _in_order(self._warnings)

    def raise_mistakes(self) -> None:
        """Raise GraphError if there is any mistake."""
        if self._mistakes:
            raise GraphError(_in_order(self._mistakes))

    def _placed(self, steps: Steps, what: str, at_key: bool) -> tuple[Mark, Mistake]:
        assert self.tree is not None
        node, found = self.tree.find(steps)
        mark = node.mark
        if node.key is not None and (at_key or found != steps or node.children()):
            mark = node.key  # a whole block is named by its key
        if node.parameter and found == steps:
            what += f" ({node.parameter})"
        written = [
            step
            for number, step in enumerate(steps)
            if number >= len(found) or not self.tree.find(steps[: number + 1])[0].implied
        ]
        return mark, _mistake(mark, spelled(written), what)


def spelled(steps: Sequence[str | int]) -> str:
    """``stages.fuse.inputs.boxes.from[1]``"""
    text = ""
    for step in steps:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def _mistake(mark: Mark, path: str, what: str) -> Mistake:
    origin = mark.origin
    if origin.lines:
        return Mistake(origin.name, mark.line, mark.column, path, what)
    # The name of a setting is the path already.
    return Mistake(origin.name, 0, 0, "" if origin.name.endswith(f" {path}") else path, what)


def _in_order(entries: list[tuple[Mark, Mistake]]) -> tuple[Mistake, ...]:
    def place(entry: tuple[Mark, Mistake]) -> tuple[int, int, int]:
        mark = entry[0]
        return mark.origin.order, mark.line, mark.column

    return tuple(mistake for _, mistake in sorted(entries, key=place))
