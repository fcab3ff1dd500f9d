"""Reads YAML text into nodes that know their place; every way in which text can be wrong is a
mistake.

Plain scalars follow YAML 1.2, as editors read them: `on`, `yes` and `no` are text, `12:30` is not a
number of minutes, `1e3` is a number. The text is read as a stream of events, never by recursion,
so that nothing nested too deep or repeated too often can hurt.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import NoReturn

import yaml

from pipeline.graph.nodes import Mark, Node, Origin, Scalar, Steps
from pipeline.graph.report import Report
from pipeline.graph.wording import shown

MAX_DEPTH = 32
MAX_NODES = 100_000  #: with aliases and parameters written out

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_STR_TAG = "tag:yaml.org,2002:str"
_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")

#: libyaml's words for what people really do, and ours.
_PLAIN_WORDS = {
    "mapping values are not allowed in this context": "a second ':' in one line, or a wrong "
    "indentation above it; quote the text if the ':' belongs to it",
    "could not find expected ':'": "a key without its ':'",
    "did not find expected key": "the indentation does not match the lines above",
    "found unexpected end of stream": "a quote is opened and never closed",
    "did not find expected ',' or ']'": "a '[' is opened and never closed, or a ',' is missing",
    "did not find expected ',' or '}'": "a '{' is opened and never closed, or a ',' is missing",
    "did not find expected '-' indicator": "a list and a mapping are mixed, or the indentation "
    "does not match the lines above",
}
#: Of these the beginning says more than the place where the reader gave up.
_SEEN_TOO_LATE = (
    "could not find expected ':'",
    "found unexpected end of stream",
    "did not find expected ',' or ']'",
    "did not find expected ',' or '}'",
)


class NotRead(Exception):
    """The text cannot be read at all; the report says why."""


@dataclass(slots=True)
class _Open:
    """A list or mapping whose end has not come yet."""

    mark: Mark
    anchor: str | None
    entries: dict[str, Node] | None  #: None for a list
    items: list[Node] = field(default_factory=list)
    key: tuple[str | None, Mark] | None = None  #: whose value comes next; (None, ...): refused
    below: list[Node] = field(default_factory=list)  #: mappings merged by ``<<``


def read_yaml(text: str, origin: Origin, report: Report) -> Node | None:
    """The document in `text`, None where it is empty.

    What can be passed over (duplicate keys, tags, NaN) is reported and passed over. Raises NotRead,
    with a mistake reported, where nothing sensible can be made of the text.
    """
    try:
        return _Reader(origin, report).document(text)
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        mark = Mark(origin, before.count("\n") + 1, len(before) - before.rfind("\n"))
        _fail(report, mark, "not YAML: a control character")
    except yaml.MarkedYAMLError as error:
        problem = error.problem or "cannot be read"
        at = error.problem_mark
        if "cannot start any token" in problem and at is not None:
            line = "".join(text.splitlines()[at.line : at.line + 1])
            character = line[at.column : at.column + 1]
            problem = (
                "a tab; indent with spaces"
                if character == "\t"
                else f"a value cannot begin with '{character}'; put it in quotes"
            )
        if error.context_mark is not None and problem in _SEEN_TOO_LATE:
            at = error.context_mark
        mark = Mark(origin, at.line + 1, at.column + 1) if at else Mark(origin)
        _fail(report, mark, f"not YAML: {_PLAIN_WORDS.get(problem, problem)}")


def _fail(report: Report, mark: Mark, what: str) -> NoReturn:
    report.mistake_at(mark, what)
    raise NotRead


class _Reader:
    def __init__(self, origin: Origin, report: Report) -> None:
        self._origin = origin
        self._nowhere = Mark(origin)
        self._report = report
        self._open: list[_Open] = []
        self._anchors: dict[str, Node | None] = {}  #: None while the anchored value is still open
        self._root: Node | None = None
        self._count = 0

    def document(self, text: str) -> Node | None:
        documents = 0
        for event in yaml.parse(text, Loader=_Loader):
            start = event.start_mark
            mark = Mark(self._origin, start.line + 1, start.column + 1) if start else self._nowhere
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    _fail(self._report, mark, "a second document begins here; a file holds one")
            elif isinstance(event, yaml.ScalarEvent):
                self._scalar(event, mark)
            elif isinstance(event, yaml.AliasEvent):
                self._alias(str(event.anchor), mark)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._begin(event, mark)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._end()
        return self._root

    def _begin(self, event: yaml.CollectionStartEvent, mark: Mark) -> None:
        if event.tag is not None:
            self._refuse_tag(event.tag, mark)
        if len(self._open) >= MAX_DEPTH:
            _fail(self._report, mark, f"is nested more than {MAX_DEPTH} levels deep")
        mapping = isinstance(event, yaml.MappingStartEvent)
        self._open.append(_Open(mark, event.anchor, {} if mapping else None))
        if event.anchor is not None:
            self._anchors[event.anchor] = None

    def _end(self) -> None:
        done = self._open.pop()
        if done.entries is None:
            node = Node(tuple(done.items), done.mark)
        else:
            below = {key: child for base in done.below for key, child in base.entries().items()}
            node = Node({**below, **done.entries}, done.mark)
        self._add(node, done.anchor, new=1)

    def _alias(self, anchor: str, mark: Mark) -> None:
        if anchor not in self._anchors:
            _fail(self._report, mark, f"no anchor '&{anchor}' stands above this alias")
        node = self._anchors[anchor]
        if node is None:
            _fail(self._report, mark, f"the alias '*{anchor}' stands inside its own anchor")
        self._add(node, None, new=node.size)

    def _scalar(self, event: yaml.ScalarEvent, mark: Mark) -> None:
        node = Node(event.value, mark)
        if event.tag not in (None, "!", _STR_TAG):
            self._refuse_tag(event.tag, mark)
            node = replace(node, broken=True)
        elif event.tag is None and event.implicit[0]:
            node = self._resolve(node)
        frame = self._open[-1] if self._open else None
        if frame is None or frame.entries is None or frame.key is not None or event.anchor:
            self._add(node, event.anchor, new=1)
            return
        # Only text is a name; `on` and `yes` are text here, 1, true and null are not.
        if isinstance(node.value, str):
            self._key(event.value, mark)
        else:
            self._refuse(f"the key {event.value} is no text; quote it if it is a name", mark)
            frame.key = (None, mark)

    def _key(self, key: str, mark: Mark) -> None:
        frame = self._open[-1]
        frame.key = (key, mark)
        first = frame.entries.get(key) if frame.entries else None
        if first is not None and first.key is not None:
            self._refuse(f"the key '{key}' is here twice (first in line {first.key.line})", mark)

    def _add(self, node: Node, anchor: str | None, *, new: int) -> None:
        self._count += new
        if self._count > MAX_NODES or node.depth + len(self._open) > MAX_DEPTH:
            what = f"grows beyond {MAX_NODES:,} values or {MAX_DEPTH} levels; are aliases repeated?"
            _fail(self._report, node.mark, what)
        if anchor is not None:
            self._anchors[anchor] = node
        if not self._open:
            self._root = node
            return
        frame = self._open[-1]
        if frame.entries is None:
            frame.items.append(replace(node, key=None))
        elif frame.key is None:
            self._refuse("a key must be plain text", node.mark)
            frame.key = (None, node.mark)
        else:
            (key, mark), frame.key = frame.key, None
            if key == "<<":
                self._merge(frame, node)
            elif key is not None:
                frame.entries[key] = replace(node, key=mark)

    def _merge(self, frame: _Open, node: Node) -> None:
        bases = node.value if isinstance(node.value, tuple) else (node,)
        if all(isinstance(base.value, dict) for base in bases):
            frame.below += reversed(bases)  # the first one wins
        else:
            self._refuse("'<<' merges mappings only", node.mark)

    def _resolve(self, node: Node) -> Node:
        """A plain scalar gets the type that it looks like."""
        text = str(node.value)
        why = ""
        if text in _WORDS:
            return replace(node, value=_WORDS[text])
        if _NOT_FINITE.fullmatch(text):
            why = "is no finite number"
        elif _INT.fullmatch(text):
            base = {"0x": 16, "0o": 8}.get(text[:2], 10)
            if len(text) <= 30 and abs(whole := int(text, base)) < 2**63:
                return replace(node, value=whole)
            why = "does not fit into 64 bits"
        elif _FLOAT.fullmatch(text):
            if math.isfinite(number := float(text)):
                return replace(node, value=number)
            why = "is too large for a number"
        if why:
            self._refuse(f"{shown(text)} {why}", node.mark)
        return replace(node, broken=bool(why))

    def _refuse(self, what: str, mark: Mark) -> None:
        self._report.mistake_at(mark, what, self._steps())

    def _refuse_tag(self, tag: str, mark: Mark) -> None:
        name = tag.replace("tag:yaml.org,2002:", "!!")
        self._refuse(
            f"the tag {name} asks to build an object; a graph file holds plain values only", mark
        )

    def _steps(self) -> Steps:
        """Where the reader stands, as a path."""
        steps: list[str | int] = []
        for frame in self._open:
            if frame.entries is None:
                steps.append(len(frame.items))
            elif frame.key is not None:
                steps.append(frame.key[0] or "?")
        return tuple(steps)
