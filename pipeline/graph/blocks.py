"""A device block of the file as plain values, to make the device again in another process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.graph.nodes import Mark, Node, Origin
from pipeline.graph.parts import PartMaker
from pipeline.graph.report import Report
from pipeline.model import Accelerator


def pack(node: Node) -> Any:
    """A node as JSON values: [value, the folder that relative paths in it are relative to]."""
    value: Any = node.value
    if isinstance(value, dict):
        value = {key: pack(child) for key, child in value.items()}
    elif isinstance(value, tuple):
        value = [pack(child) for child in value]
    return [value, str(node.base.resolve())]


def make_device(name: str, use: str, packed: Any) -> Accelerator:
    """The device of a packed block. Raises GraphError where its options are wrong here."""
    origin = Origin(f"devices.{name}", Path.cwd(), 0, lines=False)
    block = _unpack(packed, origin)
    root = Node({"devices": Node({name: block}, Mark(origin))}, Mark(origin))
    report = Report()
    report.tree = root
    part = PartMaker(root, report).device(name, use)
    report.raise_mistakes()
    assert part is not None
    assert part.instance is not None
    return part.instance


def _unpack(packed: Any, origin: Origin) -> Node:
    value, folder = packed
    if isinstance(value, dict):
        value = {key: _unpack(child, origin) for key, child in value.items()}
    elif isinstance(value, list):
        value = tuple(_unpack(child, origin) for child in value)
    return Node(value, Mark(origin), folder=Path(folder))
