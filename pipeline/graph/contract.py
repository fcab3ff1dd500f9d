"""Reads the contract of a stage class from its annotations: options, input ports, output ports."""

from __future__ import annotations

import collections.abc
import inspect
import re
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Union, get_args, get_origin

from pipeline.message import Message
from pipeline.stage import ModelStage, Source, Stage

#: An `__init__` parameter of this name is the graph's calibration, not an option.
CALIBRATION = "calibration"


class ContractError(Exception):
    """A class does not say what it takes and gives; the text is a sentence for its author."""


@dataclass(frozen=True, slots=True)
class Option:
    """One option of a class: a parameter of its `__init__`."""

    name: str
    annotation: Any  #: a type; Any where none is written
    default: Any = inspect.Parameter.empty
    doc: str = ""  #: the sentence of the docstrings that names it between backquotes

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    @property
    def kind(self) -> Any:
        """The annotation without None, where it is a union with it."""
        kinds = [member for member in _members(self.annotation) if member is not type(None)]
        return kinds[0] if len(kinds) == 1 else self.annotation

    @property
    def type_name(self) -> str:
        """The annotation as one would write it."""
        return type_name(self.annotation)


@dataclass(frozen=True, slots=True)
class InputPort:
    """A named message of `process` or `prepare`."""

    name: str
    payload: tuple[Any, ...]  #: the types that it takes; Any takes all
    optional: bool = False  #: may be None
    many: bool = False  #: takes several edges, each of which may be None
    span: bool = False  #: takes all messages around the set
    has_default: bool = False  #: a file may leave its edge out


@dataclass(frozen=True, slots=True)
class OutputPort:
    """What a stage says on one port."""

    name: str
    payload: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Contract:
    """What a stage class takes and gives."""

    options: tuple[Option, ...]
    inputs: tuple[InputPort, ...]  #: in the order of the signature; none for a source
    outputs: tuple[OutputPort, ...]  #: none for a sink
    is_source: bool
    is_model: bool
    calibration: Option | None  #: the `__init__` parameter that takes the calibration
    doc: str  #: the class's docstring, cleaned

    def input(self, name: str) -> InputPort | None:
        return next((port for port in self.inputs if port.name == name), None)

    def output(self, name: str) -> OutputPort | None:
        return next((port for port in self.outputs if port.name == name), None)


def contract_of(cls: type[Stage]) -> Contract:
    """The contract that the annotations of `cls` state. Raises ContractError."""
    is_source, is_model = issubclass(cls, Source), issubclass(cls, ModelStage)
    if inspect.isabstract(cls):
        lacks = ", ".join(sorted(vars(cls)["__abstractmethods__"]))
        raise ContractError(f"{cls.__name__} is the base of other stages; it lacks {lacks}")
    options = options_of(cls)
    inputs: tuple[InputPort, ...] = ()
    if is_source:
        outputs: tuple[OutputPort, ...] = (_source_output(cls),)
    else:
        last = _method(cls, "finish" if is_model else "process")
        first = _method(cls, "prepare") if is_model else last
        inputs = _inputs(cls, first)
        if is_model:
            _check_finish(cls, first, last)
        outputs = _outputs(cls, last)
    return Contract(
        options=tuple(option for option in options if option.name != CALIBRATION),
        inputs=inputs,
        outputs=outputs,
        is_source=is_source,
        is_model=is_model,
        calibration=next((option for option in options if option.name == CALIBRATION), None),
        doc=inspect.cleandoc(cls.__doc__ or ""),
    )


def options_of(target: Callable[..., Any]) -> tuple[Option, ...]:
    """The options that a class or function takes by name. Raises ContractError."""
    function = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    name = getattr(target, "__name__", str(target))
    if function is object.__init__:
        return ()
    hints = _hints(function, name)
    docs = f"{function.__doc__ or ''}\n\n{target.__doc__ or ''}"
    parameters = list(inspect.signature(function).parameters.values())
    options = []
    for parameter in parameters[1:] if isinstance(target, type) else parameters:
        if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
            raise ContractError(
                f"{name} takes {_starred(parameter)}; name each option in its signature"
            )
        annotation = hints.get(parameter.name, Any)
        doc = _sentence_on(parameter.name, docs)
        options.append(Option(parameter.name, annotation, parameter.default, doc))
    return tuple(options)


def type_name(annotation: Any) -> str:
    """A type as its author wrote it, without module names."""
    if annotation is type(None):
        return "None"
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return type_name(arguments[0])
    if origin is typing.Literal:
        return " | ".join(repr(argument) for argument in arguments)
    if origin in (Union, types.UnionType):
        return " | ".join(map(type_name, arguments))
    if origin is not None and arguments:
        inner = ", ".join("..." if item is ... else type_name(item) for item in arguments)
        return f"{type_name(origin)}[{inner}]"
    return getattr(annotation, "__name__", None) or str(annotation)


def fits(given: tuple[Any, ...], taken: tuple[Any, ...]) -> bool:
    """Whether every type of an output is one that the input takes."""
    return all(any(_is_a(one, other) for other in taken) for one in given)


def _is_a(given: Any, taken: Any) -> bool:
    if Any in (given, taken) or taken is object:
        return True
    try:
        return issubclass(given, taken)
    except TypeError:
        return True  # a protocol that cannot be asked: the annotation is taken at its word


def _sentence_on(name: str, docs: str) -> str:
    sentences = re.split(r"(?<=\.)\s+|\n\s*\n", docs)
    found = (sentence for sentence in sentences if f"`{name}`" in sentence)
    return " ".join(next(found, "").split())


def _method(cls: type, name: str) -> Callable[..., Any]:
    method = getattr(cls, name, None)
    if method is None:
        raise ContractError(
            f"{cls.__name__} has no method '{name}'; a Stage defines process, a ModelStage prepare "
            "and finish, a Source messages"
        )
    if inspect.iscoroutinefunction(method) or inspect.isasyncgenfunction(method):
        raise ContractError(f"{cls.__name__}.{name} is async; a step is a plain method")
    return typing.cast(Callable[..., Any], method)


def _hints(function: Callable[..., Any], name: str) -> dict[str, Any]:
    try:
        return typing.get_type_hints(function, include_extras=True)
    except Exception as error:  # whatever evaluating an annotation raises
        raise ContractError(
            f"an annotation of {name} cannot be read: {error}; import what it names at run time, "
            "not under TYPE_CHECKING"
        ) from None


def _inputs(cls: type, method: Callable[..., Any]) -> tuple[InputPort, ...]:
    place = f"{cls.__name__}.{method.__name__}"
    hints = _hints(method, place)
    ports = []
    for parameter in list(inspect.signature(method).parameters.values())[1:]:
        if parameter.kind is not parameter.POSITIONAL_OR_KEYWORD:
            raise ContractError(
                f"{place} takes {_starred(parameter)}; name each input, without * or **"
            )
        if parameter.name not in hints:
            raise ContractError(f"{place}: annotate '{parameter.name}' as Message[...]")
        port = _input(parameter.name, hints[parameter.name])
        if port is None:
            raise ContractError(
                f"{place}: '{parameter.name}' is {type_name(hints[parameter.name])}; an input is "
                "Message[T], Message[T] | None, tuple[Message[T] | None, ...] or Span[T]"
            )
        has_default = parameter.default is not parameter.empty
        ports.append(replace(port, has_default=has_default))
    if not ports:
        raise ContractError(f"{place} takes no message; a stage without inputs is a Source")
    return tuple(ports)


def _input(name: str, annotation: Any) -> InputPort | None:
    members = _members(annotation)
    optional = type(None) in members
    members = [member for member in members if member is not type(None)]
    if len(members) == 1 and get_origin(members[0]) is tuple:
        inside, *rest = get_args(members[0])
        if rest != [...]:
            return None
        edge = _input(name, inside)
        if edge is None or edge.many or edge.span:
            return None
        if edge.optional:
            return None if optional else InputPort(name, edge.payload, optional=True, many=True)
        return InputPort(name, edge.payload, optional=optional, span=True)
    if not members or not all(_is_message(member) for member in members):
        return None
    payload = tuple(kind for member in members for kind in _payload(member))
    return InputPort(name, payload, optional=optional)


def _starred(parameter: inspect.Parameter) -> str:
    if parameter.kind is parameter.VAR_KEYWORD:
        return f"**{parameter.name}"
    return (
        f"*{parameter.name}"
        if parameter.kind is parameter.VAR_POSITIONAL
        else f"*, {parameter.name}"
    )


def _check_finish(cls: type, prepare: Callable[..., Any], finish: Callable[..., Any]) -> None:
    before, after = (list(inspect.signature(method).parameters)[1:] for method in (prepare, finish))
    if after[1:] != before:
        raise ContractError(
            f"{cls.__name__}.finish must take the model's outputs and then the inputs of prepare "
            f"({', '.join(before)}); it takes ({', '.join(after)})"
        )


def _source_output(cls: type) -> OutputPort:
    place = f"{cls.__name__}.messages"
    returned = _hints(_method(cls, "messages"), place).get("return")
    arguments = get_args(returned)
    iterable = isinstance(origin := get_origin(returned), type) and issubclass(
        origin, collections.abc.Iterable
    )
    if not iterable or not arguments or not all(map(_is_message, _members(arguments[0]))):
        raise ContractError(f"{place}: annotate what it returns as Iterator[Message[...]]")
    kinds = [kind for member in _members(arguments[0]) for kind in _payload(member)]
    return OutputPort("out", tuple(kinds))


def _outputs(cls: type, method: Callable[..., Any]) -> tuple[OutputPort, ...]:
    place = f"{cls.__name__}.{method.__name__}"
    hints = _hints(method, place)
    if "return" not in hints:
        raise ContractError(f"{place}: annotate what it returns (None for a sink)")
    members = [member for member in _members(hints["return"]) if member is not type(None)]
    if not members:
        return ()
    if len(members) == 1 and (names := getattr(members[0], "__ports__", None)):
        fields = _hints(members[0], members[0].__name__)
        return tuple(OutputPort(name, _output_payload(fields[name])) for name in names)
    return (OutputPort("out", _output_payload(hints["return"])),)


def _output_payload(annotation: Any) -> tuple[Any, ...]:
    members = [member for member in _members(annotation) if member is not type(None)]
    return tuple(
        kind
        for member in members
        for kind in (_payload(member) if _is_message(member) else [_class(member)])
    )


def _is_message(annotation: Any) -> bool:
    return annotation is Message or get_origin(annotation) is Message


def _payload(message: Any) -> list[Any]:
    """The payload types of ``Message[A | B]``; Any for a bare Message."""
    return [
        _class(member) for argument in get_args(message) or (Any,) for member in _members(argument)
    ]


def _members(annotation: Any) -> list[Any]:
    """The members of a union, else the annotation itself."""
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    union = get_origin(annotation) in (Union, types.UnionType)
    return list(get_args(annotation)) if union else [annotation]


def _class(annotation: Any) -> Any:
    """What can be compared of a type: its class; Any where it has none."""
    origin = get_origin(annotation)
    if isinstance(origin, type):
        return origin
    return annotation if isinstance(annotation, type) else Any
