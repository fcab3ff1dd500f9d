"""Shows stage classes as the framework sees them: which there are, their ports, their options."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
from collections.abc import Mapping, Sequence
from typing import Any

import typer

import stages
from pipeline.graph.contract import Contract, ContractError, contract_of, type_name
from pipeline.graph.wording import suggest
from pipeline.stage import ModelStage, Source, Stage


def shipped_stages() -> list[type[Stage]]:
    """Every stage class of the package `stages` that a graph may name, by module and then in the
    file's order."""
    names = [
        module.name
        for module in pkgutil.walk_packages(stages.__path__, "stages.")
        if not module.name.startswith("stages.kernels")
    ]
    return [
        cls
        for name in names
        for cls in vars(importlib.import_module(name)).values()
        if isinstance(cls, type)
        and issubclass(cls, Stage)
        and cls.__module__ == name
        and not cls.__name__.startswith("_")
        and not inspect.isabstract(cls)
    ]


def use_of(cls: type[Stage]) -> str:
    """How a graph file names the class."""
    return f"{cls.__module__}:{cls.__qualname__}"


def find_stage(name: str) -> type[Stage]:
    """The class that ``module:Class`` names, or a shipped one by its class or module name.

    Raises typer.BadParameter; what a module of the user raises while it is imported goes through.
    """
    if ":" in name:
        return _imported(*name.split(":", 1))
    shipped = shipped_stages()
    found = [cls for cls in shipped if name.lower() in _short_names(cls)]
    if len(found) == 1:
        return found[0]
    if found:
        uses = ", ".join(use_of(cls) for cls in found)
        raise typer.BadParameter(f"'{name}' may be {uses}: name one of them")
    known = [word for cls in shipped for word in (cls.__name__, cls.__module__.split(".")[-1])]
    way_out = suggest(name, known, or_list=False) or "; `overflight stages` lists them"
    raise typer.BadParameter(f"no stage '{name}'{way_out}")


def stages_text() -> str:
    """The shipped classes by kind, one line each."""
    shipped = {cls: contract_of(cls) for cls in shipped_stages()}
    width = max(len(use_of(cls)) for cls in shipped)
    groups: dict[str, list[str]] = {"Sources": [], "Stages": [], "Sinks": []}
    for cls, contract in shipped.items():
        first_line = contract.doc.partition("\n")[0]
        groups[_kind(contract)].append(f"  {use_of(cls):{width}}  {first_line}")
    return "\n".join(line for group, lines in groups.items() for line in [group, *lines])


def stages_json() -> str:
    """The shipped classes with all that `inspect` knows of them."""
    return json.dumps([_as_values(cls) for cls in shipped_stages()], indent=2)


def stage_json(cls: type[Stage]) -> str:
    """One class."""
    return json.dumps(_as_values(cls), indent=2)


def stage_text(cls: type[Stage]) -> str:
    """One class for a person, much as gst-inspect does it."""
    values = _as_values(cls)
    paragraphs = [values["use"], values["doc"]]
    if values["traits"]:
        paragraphs[0] += f"   ({', '.join(values['traits'])})"
    inputs = [
        (port["name"], " | ".join(port["payload"]), ", ".join(port["rules"]))
        for port in values["inputs"]
    ]
    outputs = [(port["name"], " | ".join(port["payload"])) for port in values["outputs"]]
    options = [
        (
            option["name"],
            option["type"],
            "required" if option["required"] else f"default {option['default']}",
            _said_of(option, values["options"]),
        )
        for option in values["options"]
    ]
    for title, rows in (("Inputs", inputs), ("Outputs", outputs), ("Options", options)):
        paragraphs.append("\n".join([title, *_aligned(rows or [("none",)])]))
    return "\n\n".join(paragraph for paragraph in paragraphs if paragraph)


def _said_of(option: Mapping[str, Any], options: Sequence[Mapping[str, Any]]) -> str:
    """The sentence on an option; where one sentence is on several, it stands at the first."""
    first = next(other for other in options if other["doc"] == option["doc"])
    return option["doc"] if first is option or not option["doc"] else f"see {first['name']}"


def _imported(module: str, name: str) -> type[Stage]:
    try:
        found = vars(importlib.import_module(module)).get(name)
    except (ModuleNotFoundError, ValueError) as error:
        if isinstance(error, ModuleNotFoundError) and not f"{module}.".startswith(f"{error.name}."):
            raise  # the module is there; something that it imports is not
        raise typer.BadParameter(
            f"no module '{module}'; modules of the working folder and installed ones are looked up"
        ) from None
    if isinstance(found, type) and issubclass(found, Stage):
        return found
    if found is not None:
        raise typer.BadParameter(f"{module}:{name} is not a Stage class")
    classes = [
        key
        for key, value in vars(importlib.import_module(module)).items()
        if isinstance(value, type) and issubclass(value, Stage) and value.__module__ == module
    ]
    raise typer.BadParameter(f"module '{module}' has no '{name}'{suggest(name, classes)}")


def _short_names(cls: type[Stage]) -> set[str]:
    return {cls.__name__.lower(), cls.__module__.split(".")[-1].lower()}


def _kind(contract: Contract) -> str:
    if contract.is_source:
        return "Sources"
    return "Stages" if contract.outputs else "Sinks"


def _as_values(cls: type[Stage]) -> dict[str, Any]:
    try:
        contract = contract_of(cls)
    except ContractError as error:
        raise typer.BadParameter(str(error)) from None
    traits = {
        "source": issubclass(cls, Source),
        "with a model": issubclass(cls, ModelStage),
        "needs calibration": contract.calibration is not None,
        "stateless": cls.stateless,
        "inline": cls.inline,
    }
    return {
        "use": use_of(cls),
        "doc": contract.doc,
        "kind": _kind(contract).removesuffix("s").lower(),
        "traits": [trait for trait, has in traits.items() if has],
        "inputs": [
            {
                "name": port.name,
                "payload": [type_name(payload) for payload in port.payload],
                "rules": [
                    rule
                    for rule, holds in {
                        "may be missing": port.optional and not port.many,
                        "several edges": port.many,
                        "all messages around the set": port.span,
                    }.items()
                    if holds
                ],
            }
            for port in contract.inputs
        ],
        "outputs": [
            {"name": port.name, "payload": [type_name(payload) for payload in port.payload]}
            for port in contract.outputs
        ],
        "options": [
            {
                "name": option.name,
                "type": option.type_name,
                "required": option.required,
                "default": None if option.required else _plain(option.default),
                "doc": option.doc,
            }
            for option in contract.options
        ],
    }


def _plain(default: Any) -> Any:
    """A default as a graph file would write it."""
    if isinstance(default, tuple | list):
        return [_plain(value) for value in default]
    return default if isinstance(default, str | int | float | None) else str(default)


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    columns = max(map(len, rows))
    widths = [max(len(row[i]) for row in rows if i < len(row)) for i in range(columns)]
    return [
        (
            "  " + "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    ]
