"""Turns the options of a graph file into the arguments of a class: types checked, paths
resolved."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, PydanticUserError, TypeAdapter, ValidationError

from pipeline.errors import OverflightError
from pipeline.graph.contract import CALIBRATION, ContractError, Option, options_of, type_name
from pipeline.graph.nodes import Node, Steps
from pipeline.graph.report import Report
from pipeline.graph.wording import explain, suggest
from pipeline.model import Accelerator


def import_name(use: str) -> Any:
    """What ``module:name`` names. Raises ImportError, its text a sentence for the graph's
    author."""
    module_name, _, name = use.partition(":")
    if not name:
        raise ImportError(f"'{use}' names nothing; write module:name")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if module_name != missing and not module_name.startswith(missing + "."):
            raise ImportError(
                f"module '{module_name}' needs '{missing}', which is not installed"
            ) from None
        raise ImportError(f"no module '{missing}'{_like_module(missing)}") from None
    except (Exception, SystemExit) as error:  # whatever the module does when it is imported
        kind = type(error).__name__
        raise ImportError(f"module '{module_name}' cannot be imported: {kind}: {error}") from None
    if not hasattr(module, name):
        own = [
            key
            for key, value in vars(module).items()
            if getattr(value, "__module__", "") == module_name
        ]
        public = [key for key in own if not key.startswith("_")]
        raise ImportError(f"module '{module_name}' has no '{name}'{suggest(name, public)}")
    return getattr(module, name)


def _like_module(missing: str) -> str:
    parent, _, last = missing.rpartition(".")
    package = sys.modules.get(parent)
    if not parent or package is None:
        return "; it is neither installed nor in the working folder"
    siblings = [module.name for module in pkgutil.iter_modules(getattr(package, "__path__", ()))]
    likely = suggest(last, siblings, or_list=False)
    return likely.replace("mean '", f"mean '{parent}.")


def bind_options(
    options: tuple[Option, ...], owner: str, given: Mapping[str, Node], steps: Steps, report: Report
) -> dict[str, Any] | None:
    """The arguments that `given` (the block at `steps`) stands for; None where one is wrong.

    Values are taken strictly: "3" is no number, while 3 is a fine float.
    """
    arguments: dict[str, Any] = {}
    sound = True
    misspelled = False
    known = {option.name: option for option in options}
    for name in given:
        if name not in known:
            what = f"{owner} has no option '{name}'"
            what += suggest(name, known) if known else "; it takes none"
            report.mistake((*steps, name), what, at_key=True)
            misspelled = True
    for option in options:
        node = given.get(option.name)
        if node is None:
            if option.required:
                sound = False
                if not misspelled:  # then it may be this one
                    what = f"misses the option '{option.name}' ({option.type_name})"
                    report.mistake(steps, what)
            continue
        if option.kind is Accelerator and node.value is not None:
            device = _device(node, (*steps, option.name), report)
            arguments[option.name] = device
            sound = sound and device is not None
            continue
        try:
            arguments[option.name] = _convert(option, node, report.paths)
        except _WrongValue as error:
            for inside, sentence in error.found:
                report.mistake((*steps, option.name, *inside), sentence)
            sound = False
    return arguments if sound and not misspelled else None


def build(
    target: Callable[..., Any], arguments: Mapping[str, Any], steps: Steps, report: Report
) -> Any:
    """What the class or function makes of its options; None, with a mistake, where it refuses.

    Only the errors by which a constructor refuses a value are mistakes of the file; any other is a
    defect of the class and keeps its traceback.
    """
    try:
        return target(**arguments)
    except (ValueError, LookupError, OverflightError) as error:
        sentence = str(error.args[0]) if error.args else ""
        if " " not in sentence:  # the bare key of a KeyError
            name = getattr(target, "__name__", "it")
            sentence = f"{name} refuses these options: {type(error).__name__}: {sentence}"
        named = next((name for name in arguments if sentence.startswith(f"{name} ")), None)
        place = (*steps, named) if named and report.has((*steps, named)) else steps
        report.mistake(place, sentence)
        return None


def device_class(use: str) -> tuple[type[Accelerator], tuple[Option, ...]]:
    """The accelerator that ``module:Class`` names, and its options. Raises ImportError,
    ContractError."""
    cls = import_name(use)
    if not isinstance(cls, type) or not hasattr(cls, "kinds"):
        raise ContractError(f"{use} is no accelerator: it has no 'kinds' of models it runs")
    return cls, options_of(cls)


def _device(block: Node, steps: Steps, report: Report) -> Accelerator | None:
    """A device within the options of another, written as in `devices`; None where it is wrong."""
    given = dict(block.entries())
    use = given.pop("use", None)
    if use is None or not isinstance(use.value, str):
        report.mistake(steps, "is a device of its own; write {use: module:Class, ...}")
        return None
    try:
        cls, wanted = device_class(use.value)
    except (ImportError, ContractError) as error:
        report.mistake((*steps, "use"), str(error))
        return None
    arguments = bind_options(wanted, use.value, given, steps, report)
    device: Accelerator | None = None
    if arguments is not None:
        device = build(cls, arguments, steps, report)
    return device


class _WrongValue(Exception):
    def __init__(self, found: list[tuple[Steps, str]]) -> None:
        self.found = found


def _convert(option: Option, node: Node, paths: dict[int, Path]) -> Any:
    value = node.plain()
    try:
        converted = _adapter(option.annotation).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        raise _WrongValue(explain(error.errors(), value)) from None
    except PydanticUserError:
        what = f"is annotated {option.type_name}, which a graph file cannot hold"
        raise _WrongValue([((), what)]) from None
    return _with_paths(converted, node, paths)


def _adapter(annotation: Any) -> TypeAdapter[Any]:
    try:
        return TypeAdapter(annotation, config=ConfigDict(arbitrary_types_allowed=True))
    except PydanticUserError:
        return TypeAdapter(annotation)  # a model or dataclass, which brings its own config


def _with_paths(value: Any, node: Node, paths: dict[int, Path]) -> Any:
    """Relative paths begin where the file lies that wrote them; `paths` gets them by node."""
    if isinstance(value, Path):
        path = node.base / os.path.expanduser(value)  # noqa: PTH111  # which raises for no user
        paths[id(node)] = path
        return path
    children = node.children()
    if type(value) in (list, tuple) and len(value) == len(children):
        return type(value)(_with_paths(item, children[at], paths) for at, item in enumerate(value))
    if type(value) is dict and set(value) <= set(children):
        return {key: _with_paths(item, children[key], paths) for key, item in value.items()}
    return value


class CalibrationBlock:
    """The `calibration` block, as each class that asks for it wants it; made once per type."""

    def __init__(self, block: Node, report: Report) -> None:
        self._block = block
        self._report = report
        self._made: dict[Any, Any] = {}

    def value_for(self, option: Option) -> Any:
        """The calibration that `option` annotates; None, with a mistake, where it is wrong."""
        kind = option.kind
        if kind not in self._made:
            self._made[kind] = self._make(kind)
        return self._made[kind]

    def _make(self, kind: Any) -> Any:
        place: Steps = (CALIBRATION,)
        use = self._block.get("use")
        if use is not None:
            return self._call(use)
        if not hasattr(kind, "parse"):
            self._report.mistake(place, f"{type_name(kind)} has no 'parse' to read this block")
            return None
        try:
            return kind.parse(self._block.plain())
        except (ValueError, OverflightError) as error:
            self._report.mistake(*self._placed(str(error)))
            return None

    def _placed(self, sentence: str) -> tuple[Steps, str]:
        """A sentence that begins with a place in the block, ``front.camera: ...``, goes there."""
        place, colon, rest = sentence.partition(": ")
        steps = (CALIBRATION, *place.split("."))
        return (steps, rest) if colon and self._report.has(steps) else ((CALIBRATION,), sentence)

    def _call(self, use: Node) -> Any:
        for key in self._block.entries():
            if key not in ("use", "options"):
                what = f"unknown key '{key}' beside 'use'; known: 'options'"
                self._report.mistake((CALIBRATION, key), what, at_key=True)
        options = self._block.get("options")
        given = options.entries() if options is not None else {}
        try:
            function = import_name(str(use.value))
            wanted = options_of(function)
        except (ImportError, ContractError) as error:
            self._report.mistake((CALIBRATION, "use"), str(error))
            return None
        steps = (CALIBRATION, "options") if options is not None else (CALIBRATION,)
        arguments = bind_options(wanted, str(use.value), given, steps, self._report)
        return None if arguments is None else build(function, arguments, steps, self._report)
