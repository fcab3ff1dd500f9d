"""Puts the values of parameters where ``$name`` stands for them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from pipeline.graph.nodes import Mark, Node, Origin, Steps
from pipeline.graph.read import MAX_DEPTH, MAX_NODES
from pipeline.graph.report import Report
from pipeline.graph.run_folder import run_folder
from pipeline.graph.wording import shown, suggest

_PLACE = re.compile(r"\$(?:(?P<escaped>\$)|(?P<name>[A-Za-z_]\w*)|\{(?P<braced>[A-Za-z_]\w*)\}|)")
_LONGEST_TEXT = 65_536
#: What every file has without a word of its own.
_GIVEN = {"out": "the output folder (--out)", "run": "a folder of one run alone"}
#: What may use parameters; `include` is read before they are known.
_USERS = ("parameters", "devices", "calibration", "stages")


def resolve_parameters(tree: Node, out: Path, report: Report) -> tuple[Node, frozenset[str]]:
    """The tree with every ``$name`` replaced, and the parameters that were used.

    A value that is ``$name`` and nothing else gets the parameter's own type; inside text the
    parameter is written out. ``${name}`` separates it from letters that follow; ``$$`` is a dollar.
    Relative paths stay relative to the file that set the parameter. ``$out`` is the output folder,
    ``$run`` a folder in it that is of one run alone (`run_folder.py`).
    """
    parameters = tree.get("parameters")
    known = parameters.entries() if parameters is not None else {}
    for name, what in _GIVEN.items():
        if name in known:
            mark = known[name].key or known[name].mark
            report.mistake_at(mark, f"${name} is {what}; name it otherwise", ("parameters", name))
    resolver = _Resolver(dict(known), out, report)
    for key in _USERS:
        if (node := tree.get(key)) is not None:
            tree = tree.with_entry(key, resolver.resolve(node, (key,)))
    if tree.size > MAX_NODES:
        what = f"grows beyond {MAX_NODES:,} values when its parameters are put in"
        report.mistake_at(tree.mark, what)
        report.raise_mistakes()
    return tree, frozenset(resolver.used)


class _Resolver:
    def __init__(self, known: dict[str, Node], out: Path, report: Report) -> None:
        self._known = known
        self._report = report
        mark = Mark(Origin("--out", Path(), 0))
        self._values = {"out": Node(str(out), mark), "run": Node(str(run_folder(out)), mark)}
        self._inside: list[str] = []  #: parameters that are being resolved
        self.used: set[str] = set()

    def resolve(self, node: Node, steps: Steps, level: int = 0) -> Node:
        if level > 2 * MAX_DEPTH:
            self._report.mistake_at(node.mark, "parameters refer to each other too deep", steps)
            return replace(node, broken=True)
        if isinstance(node.value, dict):
            children = {
                key: self._parameter(key, node.mark, steps, level)
                if steps == ("parameters",)
                else self.resolve(child, (*steps, key), level + 1)
                for key, child in node.value.items()
            }
            return replace(node, value=children)
        if isinstance(node.value, tuple):
            items = (
                self.resolve(child, (*steps, number), level + 1)
                for number, child in enumerate(node.value)
            )
            return replace(node, value=tuple(items))
        if isinstance(node.value, str) and "$" in node.value:
            return self._text(node, node.value, steps, level)
        return node

    def _text(self, node: Node, text: str, steps: Steps, level: int) -> Node:
        whole = _PLACE.fullmatch(text)
        if whole is not None and (name := whole["name"] or whole["braced"]):
            value = self._use(name, node.mark, steps, level)
            said = f"from ${name}, {'set in ' if value.mark.origin.lines else ''}{value.mark}"
            return replace(
                value,
                mark=node.mark,
                key=node.key,
                folder=value.base,
                parameter=value.parameter or said,
            )
        folder = node.base
        broken = False
        parts: list[str] = []
        end = length = 0
        for match in _PLACE.finditer(text):
            name = match["name"] or match["braced"]
            part = "$"
            if name:
                value = self._use(name, node.mark, steps, level)
                part = self._written(name, value, node.mark, steps)
                broken |= value.broken
                if match.start() == 0:
                    folder = value.base  # of a path, the beginning says where it begins
            elif not match["escaped"]:
                what = "a single '$' begins the name of a parameter; write '$$' for a dollar"
                self._report.mistake_at(node.mark, what, steps)
                broken = True
            parts += text[end : match.start()], part
            length += len(parts[-1]) + len(parts[-2])
            end = match.end()
            if length > _LONGEST_TEXT:
                self._report.mistake_at(node.mark, "grows too long with its parameters", steps)
                return replace(node, broken=True)
        joined = "".join([*parts, text[end:]])
        return replace(node, value=joined, folder=folder, broken=broken)

    def _use(self, name: str, mark: Mark, steps: Steps, level: int) -> Node:
        self.used.add(name)
        return self._parameter(name, mark, steps, level)

    def _parameter(self, name: str, mark: Mark, steps: Steps, level: int) -> Node:
        if name in self._values:
            return self._values[name]
        nothing = Node(None, mark, broken=True)
        if name not in self._known:
            what = f"no parameter '${name}'{suggest(name, [*self._known, *_GIVEN])}"
            self._report.mistake_at(mark, what, steps)
            return nothing
        if name in self._inside:
            circle = [*self._inside[self._inside.index(name) :], name]
            what = "parameters refer to each other in a circle: " + " -> ".join(circle)
            self._report.mistake_at(self._known[name].mark, what, ("parameters", name))
            return nothing
        self._inside.append(name)
        value = self.resolve(self._known[name], ("parameters", name), level + 1)
        self._inside.pop()
        self._values[name] = value
        return value

    def _written(self, name: str, value: Node, mark: Mark, steps: Steps) -> str:
        if isinstance(value.value, (dict, tuple)):
            what = f"the parameter '${name}' is {shown(value.plain())}; text can hold a value only"
            self._report.mistake_at(mark, what, steps)
            return ""
        if value.value is None:
            return ""
        return shown(value.value) if isinstance(value.value, bool) else str(value.value)
