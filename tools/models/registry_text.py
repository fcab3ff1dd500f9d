"""Put an entry into a registry file and leave the rest of it, comments included, as it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from pipeline.errors import ModelError

WIDTH = 110


def with_entry(text: str, name: str, entry: Mapping[str, Any], path: Path, *, replace: bool) -> str:
    """The text of the registry file `path` with one more model, or another of that name.

    Raises ModelError where the name is there and `replace` is not set, or nothing can be added.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise ModelError(f"{path}: is not YAML: {error}") from None
    lines = text.splitlines()
    models = _value(root, "models")
    if models is None or not models.value:
        start = end = len(lines)
        indent = 2
        head = ["models:"]
        if models is not None:  # `models: {}` or `models:`
            start, end = models.start_mark.line, _last_line(models) + 1
    elif models.flow_style:
        raise ModelError(f"{path}: 'models' is written in braces; write it as an indented block")
    else:
        head, indent = [], models.value[0][0].start_mark.column
        start = end = _last_line(models) + 1
        for key, value in models.value:
            if key.value == name:
                if not replace:
                    raise ModelError(f"{path}: has a model '{name}' already; --replace rewrites it")
                start, end = key.start_mark.line, _last_line(value) + 1
    block = yaml.safe_dump(
        {name: dict(entry)}, sort_keys=False, default_flow_style=None, width=WIDTH - indent
    )
    added = [" " * indent + line if line else line for line in block.splitlines()]
    gap = [""] if start == end and lines and lines[start - 1].strip() else []
    return "\n".join([*lines[:start], *gap, *head, *added, *lines[end:]]) + "\n"


def _value(root: yaml.Node | None, key: str) -> Any:
    if isinstance(root, yaml.MappingNode):
        for name, value in root.value:
            if name.value == key:
                return value
    return None


def _last_line(node: yaml.Node) -> int:
    """The last line of a node's own text: a block ends, for the parser, only where the next begins,
    behind the comments that belong to that one."""
    if isinstance(node, yaml.ScalarNode) or getattr(node, "flow_style", False):
        column_zero = node.end_mark.column == 0 and node.end_mark.line > node.start_mark.line
        return node.end_mark.line - int(column_zero)
    parts = [part for pair in node.value for part in (pair if isinstance(pair, tuple) else (pair,))]
    return max((_last_line(part) for part in parts), default=node.start_mark.line)
