"""Reads a graph file with everything that is laid under and over it: includes, overlays, --set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.graph.nodes import Mark, Node, Origin, Steps, long_form, merge
from pipeline.graph.read import NotRead, read_yaml
from pipeline.graph.report import Report
from pipeline.graph.wording import shown, suggest

_MAX_BYTES = 1_000_000  #: a graph file of 1,000 stages has about 200,000
_MAX_FILES = 64  #: one graph and all its includes


def load_tree(
    path: Path, overlays: Sequence[Path], settings: Sequence[str], report: Report
) -> Node:
    """The merged file: includes lie under the file that names them, overlays and then settings
    over it; later ones win. Raises GraphError where one of them cannot be read.
    """
    files = _Files(report)
    layers = [files.read(file, Mark(Origin(str(file), Path(), 0))) for file in [path, *overlays]]
    layers += [files.setting(text) for text in settings]
    if any(layer is None for layer in layers):
        report.raise_mistakes()
    tree, *over = [layer for layer in layers if layer is not None]
    for layer in over:
        _know_parameters(tree, layer, report)
        tree = merge(tree, layer)
    return tree


class _Files:
    def __init__(self, report: Report) -> None:
        self._report = report
        self._count = 0

    def read(
        self, path: Path, named_at: Mark, steps: Steps = (), inside: Sequence[Path] = ()
    ) -> Node | None:
        """One file merged over its includes; `inside` are the files that are being read."""
        if self._count >= _MAX_FILES:
            self._report.mistake_at(named_at, f"more than {_MAX_FILES} files are included", steps)
            return None
        text = self._text(path, named_at, steps)
        if text is None:
            return None
        origin = self._origin(str(path), path.parent)
        try:
            root = read_yaml(text, origin, self._report)
        except NotRead:
            return None
        if root is None or not isinstance(root.value, dict):
            what = "is empty" if root is None else f"holds {shown(root.plain())}"
            what += "; a graph file is a mapping that begins with 'overflight: 1'"
            self._report.mistake_at(Mark(origin, 1, 1), what)
            return None
        if inside and (name := root.get("graph")) is not None:
            what = "only the graph file itself names the graph; an included file may not"
            self._report.mistake_at(name.key or name.mark, what, ("graph",))
        return self._over_includes(root, path, [*inside, path])

    def setting(self, text: str) -> Node | None:
        """``a.b.c=value`` as a file that says just this."""
        path, equals, value_text = text.partition("=")
        origin = self._origin(f"--set {path}", Path(), lines=False)
        steps = [step.strip() for step in path.split(".")]
        if not equals or not all(steps):
            what = "a setting looks like stages.rgb.options.rate_hz=10"
            self._report.mistake_at(Mark(origin), what)
            return None
        if steps[0] == "include":
            self._report.mistake_at(Mark(origin), "'include' cannot be set; use an overlay file")
            return None
        if len(steps) > 20:
            self._report.mistake_at(Mark(origin), "names a place more than 20 levels deep")
            return None
        try:
            value = read_yaml(value_text, origin, self._report)
        except NotRead:
            return None
        node = value or Node(None, Mark(origin))
        for step in reversed(steps):
            node = Node({step: replace(node, key=Mark(origin))}, Mark(origin))
        return long_form(node)

    def _origin(self, name: str, folder: Path, *, lines: bool = True) -> Origin:
        self._count += 1
        return Origin(name, folder, self._count, lines)

    def _over_includes(self, root: Node, path: Path, inside: Sequence[Path]) -> Node | None:
        assert isinstance(root.value, dict)
        include = root.value.get("include")
        own = long_form(
            replace(root, value={key: node for key, node in root.value.items() if key != "include"})
        )
        under: list[Node | None] = []
        for name, steps in self._include_names(include):
            assert isinstance(name.value, str)
            file = path.parent / name.value
            circle = [_same(file, other) for other in inside]
            if True in circle:
                loop = [*inside[circle.index(True) :], file]
                what = "files include each other in a circle: " + " -> ".join(map(str, loop))
                self._report.mistake_at(name.mark, what, steps)
                under.append(None)
            else:
                under.append(self.read(file, name.mark, steps, inside))
        merged: Node | None = None
        for layer in [*under, own]:
            if layer is None:
                return None
            merged = layer if merged is None else merge(merged, layer)
        return merged

    def _include_names(self, include: Node | None) -> list[tuple[Node, Steps]]:
        if include is None or include.value is None:
            return []
        names: list[tuple[Node, Steps]] = []
        if not isinstance(include.value, tuple):
            what = f"expected a list of files, got {shown(include.plain())}"
            if isinstance(include.value, str):
                what += f"; write [{include.value}]"
            self._report.mistake_at(include.mark, what, ("include",))
            return []
        for number, name in enumerate(include.value):
            if not isinstance(name.value, str):
                what = f"expected a file, got {shown(name.plain())}"
            elif "$" in name.value:
                what = "files are included before parameters are known; write the path out"
            else:
                names.append((name, ("include", number)))
                continue
            self._report.mistake_at(name.mark, what, ("include", number))
        return names

    def _text(self, path: Path, named_at: Mark, steps: Steps) -> str | None:
        try:
            with path.open("rb") as file:
                data = file.read(_MAX_BYTES + 1)
            if len(data) <= _MAX_BYTES:
                return data.decode("utf-8-sig")
            what = f"is more than {_MAX_BYTES:,} bytes long; is it a graph file?"
        except FileNotFoundError:
            what = "no such file" if named_at.line == 0 else f"no file '{path}'"
            folder = path.parent
            if folder.is_dir():
                what += suggest(path.name, sorted(other.name for other in folder.glob("*.yaml")))
        except UnicodeDecodeError:
            what = "is no text in UTF-8"
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            what = f"cannot be read: {reason[0].lower()}{reason[1:]}"
        if named_at.line and not what.startswith("no file"):
            what = f"'{path}' {what}"
        self._report.mistake_at(named_at, what, steps)
        return None


def _same(file: Path, other: Path) -> bool:
    try:
        return file.samefile(other)
    except (OSError, ValueError):
        return False  # it will not open either, which says more


def _know_parameters(tree: Node, layer: Node, report: Report) -> None:
    """A setting may change a parameter but not invent one: that would be a misspelling."""
    parameters, known = layer.get("parameters"), tree.get("parameters")
    if parameters is None or parameters.mark.origin.lines:
        return
    names = known.entries() if known is not None else {}
    for name, node in parameters.entries().items():
        if name not in names:
            what = f"the graph has no parameter '{name}'{suggest(name, names)}"
            report.mistake_at(node.mark, what, ("parameters", name))
