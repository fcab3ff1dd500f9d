"""A graph as a picture needs it, and its simple forms: Mermaid, DOT and JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Self

from pipeline.scheduling.topology import Input, Policy, Sync

if TYPE_CHECKING:
    from pipeline.graph.graph import Graph


@dataclass(frozen=True, slots=True)
class Socket:
    """An input of a box with the rule that its messages follow."""

    name: str
    sync: str
    rule: str  #: e.g. "nearest ±70 ms", "block 20", "" for a plain trigger


@dataclass(frozen=True, slots=True)
class Box:
    """A stage."""

    name: str
    use: str  #: ``module:Class``
    devices: tuple[str, ...]  #: first preferred; empty without a model
    model: str | None
    inputs: tuple[Socket, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Arrow:
    """An edge."""

    source: str  #: the stage it leaves
    port: str
    target: str  #: the stage it enters
    input: str
    sync: str
    rule: str


def milliseconds(ns: int) -> str:
    """``70 ms``, without needless digits."""
    return f"{ns / 1e6:g} ms"


def rule_of(entry: Input) -> str:
    """What an input does with its messages, in a few words; nothing for the usual trigger."""
    words = []
    if entry.sync is Sync.NEAREST:
        words.append(f"nearest ±{milliseconds(entry.tolerance)}")
    elif entry.sync is not Sync.TRIGGER:
        words.append(entry.sync.value)
    elif entry.policy is not Policy.LATEST:
        words.append(f"{entry.policy.value.replace('_', ' ')} {entry.size}")
    if entry.select:
        words.append(f"select {entry.select}")
    if entry.period:
        words.append(f"{1e9 / entry.period:g} Hz")
    return ", ".join(words)


@dataclass(frozen=True, slots=True)
class Diagram:
    """Boxes in the order of the file, and the arrows between them."""

    name: str
    boxes: tuple[Box, ...]
    arrows: tuple[Arrow, ...]

    @classmethod
    def of(cls, graph: Graph) -> Self:
        """The picture of a loaded graph."""
        boxes, arrows = [], []
        for stage, node in zip(graph.stages, graph.topology.stages, strict=True):
            sockets = []
            for entry in node.inputs:
                rule = rule_of(entry)
                sockets.append(Socket(entry.name, entry.sync.value, rule))
                arrows += [
                    Arrow(port.stage, port.name, node.name, entry.name, entry.sync.value, rule)
                    for port in entry.sources
                ]
            boxes.append(
                Box(stage.name, stage.use, node.devices, stage.model, tuple(sockets), node.outputs)
            )
        return cls(graph.name, tuple(boxes), tuple(arrows))

    def json(self) -> str:
        """Everything, for programs."""
        return json.dumps(asdict(self), indent=2)

    def mermaid(self) -> str:
        """A Mermaid flowchart, as GitHub draws it in a Markdown file."""
        # Numbers, because some words and dashes in a name mean something to Mermaid.
        ids = {box.name: f"s{number}" for number, box in enumerate(self.boxes)}
        lines = ["flowchart LR"]
        for box in self.boxes:
            devices = f"<br/><i>{' → '.join(box.devices)}</i>" if box.devices else ""
            opening, closing = "[]" if box.inputs else ("([", "])")
            lines.append(f'    {ids[box.name]}{opening}"{box.name}{devices}"{closing}')
        for arrow in self.arrows:
            line = "-->" if arrow.sync == Sync.TRIGGER else "-.->"
            label = f'|"{arrow.rule}"|' if arrow.rule else ""
            lines.append(f"    {ids[arrow.source]} {line}{label} {ids[arrow.target]}")
        return "\n".join(lines)

    def dot(self) -> str:
        """A Graphviz digraph."""
        lines = [
            f"digraph {json.dumps(self.name)} {{",
            "    rankdir=LR; node [shape=box, style=rounded];",
        ]
        for box in self.boxes:
            devices = f"\\n{' > '.join(box.devices)}" if box.devices else ""
            lines.append(f'    "{box.name}" [label="{box.name}{devices}"];')
        for arrow in self.arrows:
            style = "" if arrow.sync == Sync.TRIGGER else ", style=dashed"
            lines.append(f'    "{arrow.source}" -> "{arrow.target}" [label="{arrow.rule}"{style}];')
        return "\n".join([*lines, "}"])
