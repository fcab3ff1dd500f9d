"""A graph file as one text: what includes, overlays, settings and parameters made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pipeline.graph.nodes import Node


@dataclass(frozen=True, slots=True)
class Written:
    """The resolved file, to be written out where somebody wants it."""

    tree: Node
    paths: Mapping[int, Path]  #: where each path of an option leads, by the `id` of its node
    out: Path  #: what ``$out`` stood for

    def text(self) -> str:
        """A graph file that means the same from any folder.

        Paths are absolute, except those in the output folder: they begin with ``$out``, so that a
        run of the text does not write over what this run wrote.
        """
        root = {
            key: self._plain(node)
            for key, node in self.tree.entries().items()
            if key not in ("parameters", "include")
        }
        return yaml.safe_dump(root, sort_keys=False, width=100, allow_unicode=True)

    def _plain(self, node: Node) -> Any:
        if isinstance(node.value, dict):
            return {key: self._plain(child) for key, child in node.value.items()}
        if isinstance(node.value, tuple):
            return [self._plain(child) for child in node.value]
        path = self.paths.get(id(node))
        if path is not None:
            return self._path(path)
        return node.value.replace("$", "$$") if isinstance(node.value, str) else node.value

    def _path(self, path: Path) -> str:
        absolute, out = path.absolute(), self.out.absolute()
        if absolute.is_relative_to(out):
            inside = str(absolute.relative_to(out)).replace("$", "$$")
            return "$out" if inside == "." else f"$out/{inside}"
        return str(absolute).replace("$", "$$")
