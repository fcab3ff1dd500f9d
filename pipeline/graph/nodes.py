"""Values of a graph file that know where they were written, and how two files merge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

Scalar: TypeAlias = str | int | float | bool | None

#: A place inside a file: keys and list indices from the root.
Steps: TypeAlias = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Origin:
    """One text that values come from: a file, or one ``--set``."""

    name: str  #: as mistakes show it
    folder: Path  #: what relative paths in it are relative to
    order: int  #: mistakes are listed in the order in which the texts were read
    lines: bool = True  #: False where line numbers say nothing (``--set``)


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a text."""

    origin: Origin
    line: int = 0  #: 1-based; 0 where none is known
    column: int = 0

    def __str__(self) -> str:
        known = self.line and self.origin.lines
        return f"{self.origin.name}:{self.line}:{self.column}" if known else self.origin.name


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A value with its place; a mapping or list holds nodes. Shared freely, never changed."""

    value: Scalar | dict[str, Node] | tuple[Node, ...]
    mark: Mark
    key: Mark | None = None  #: where its key stands; None in a list, at the root and where implied
    parameter: str = ""  #: ``$name`` whose value this is, and where that was set
    folder: Path | None = None  #: what a relative path is relative to, if not its origin's
    implied: bool = False  #: not written: what a short form stands for
    broken: bool = False  #: stands for a value that a mistake was reported of already
    size: int = field(init=False)  #: nodes below it and itself, aliases counted at every use
    depth: int = field(init=False)

    def __post_init__(self) -> None:
        children = self.children().values()
        object.__setattr__(self, "size", 1 + sum(child.size for child in children))
        object.__setattr__(self, "depth", 1 + max((child.depth for child in children), default=0))

    @property
    def base(self) -> Path:
        """The folder that a relative path in this value is relative to."""
        return self.mark.origin.folder if self.folder is None else self.folder

    def children(self) -> Mapping[Any, Node]:
        """The nodes of a mapping by key, of a list by index; none for a scalar."""
        if isinstance(self.value, dict):
            return self.value
        return dict(enumerate(self.value)) if isinstance(self.value, tuple) else {}

    def entries(self) -> Mapping[str, Node]:
        """The nodes of a mapping by key; none for anything else."""
        return self.value if isinstance(self.value, dict) else {}

    def plain(self) -> Any:
        """The value without places: dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, tuple):
            return [child.plain() for child in self.value]
        return self.value

    def find(self, steps: Steps) -> tuple[Node, Steps]:
        """The deepest node on the way along `steps`, and the steps that led to it."""
        node = self
        for done, step in enumerate(steps):
            children = node.children()
            if step not in children:
                return node, steps[:done]
            node = children[step]
        return node, steps

    def get(self, *steps: str | int) -> Node | None:
        """The node at `steps`; None where there is none."""
        node, found = self.find(steps)
        return node if found == steps else None

    def with_entry(self, key: str, child: Node) -> Node:
        """The same mapping with one entry set."""
        assert isinstance(self.value, dict)
        return replace(self, value={**self.value, key: child})


#: Below these keys null is a value like any other; elsewhere it removes the entry it lies over.
_NULL_IS_A_VALUE = ("options", "parameters")


def merge(base: Node, over: Node, *, null_removes: bool = True) -> Node:
    """`base` with everything that `over` says: mappings merge key by key, all else is replaced.

    Keys keep the order of `base`; new ones follow. A null in `over` removes the entry of `base`
    (``detect_thermal: null`` takes the stage out), except among options and parameters.
    """
    if not isinstance(base.value, dict) or not isinstance(over.value, dict):
        return over
    merged = dict(base.value)
    for key, child in over.value.items():
        if key not in merged:
            merged[key] = child
        elif child.value is None and null_removes:
            del merged[key]
        else:
            merged[key] = merge(
                merged[key], child, null_removes=null_removes and key not in _NULL_IS_A_VALUE
            )
    return replace(over, value=merged)


def long_form(root: Node) -> Node:
    """The same file with its short forms written out, so that files merge whatever form they use.

    ``executor: cpu`` is ``executor: [cpu]``; ``image: rgb`` is ``image: {from: [rgb]}``.
    """
    stages = root.get("stages")
    if stages is None or not isinstance(stages.value, dict):
        return root
    long = {name: _long_stage(stage) for name, stage in stages.value.items()}
    return root.with_entry("stages", replace(stages, value=long))


def _long_stage(stage: Node) -> Node:
    if not isinstance(stage.value, dict):
        return stage
    if (executor := stage.get("executor")) is not None:
        stage = stage.with_entry("executor", _as_list(executor))
    inputs = stage.get("inputs")
    if inputs is None or not isinstance(inputs.value, dict):
        return stage
    edges = {port: _long_input(edge) for port, edge in inputs.value.items()}
    return stage.with_entry("inputs", replace(inputs, value=edges))


def _as_list(node: Node) -> Node:
    if not isinstance(node.value, str):
        return node
    return replace(node, value=(replace(node, key=None, implied=True),))


def _long_input(node: Node) -> Node:
    if isinstance(node.value, (str, tuple)):
        return replace(node, value={"from": _as_list(replace(node, key=None, implied=True))})
    source = node.get("from")
    return node if source is None else node.with_entry("from", _as_list(source))
