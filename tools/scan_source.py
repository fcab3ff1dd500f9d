"""The source of a recording's scans, as a command is told to open it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
import yaml
from pydantic import TypeAdapter, ValidationError

from pipeline.graph.contract import Option, contract_of, fits
from pipeline.graph.wording import suggest
from pipeline.stage import Source
from stages.sources.kitti import KittiScans
from stages.sources.ouster import SUFFIXES, OusterScans
from stages.sources.recording import Recording
from stages.types import Scan
from tools.show import find_stage


@contextmanager
def open_scans(recording: Path, use: str | None, settings: Sequence[str]) -> Iterator[Source]:
    """The source, open. `use` names its class, by default the one that fits the recording; its
    option `path` is the recording, others come as ``name=value``.

    Raises typer.BadParameter for what cannot be, DataError where the recording is wrong.
    """
    cls, given = (find_stage(use), {}) if use else source_of(recording)
    contract = contract_of(cls)
    gives_scans = any(fits((Scan,), port.payload) for port in contract.outputs)
    if not issubclass(cls, Source) or not gives_scans:
        raise typer.BadParameter(f"{cls.__name__} is no source of scans")
    options = {option.name: option for option in contract.options}
    told = dict(_setting(text, cls, options) for text in settings)
    arguments = {"path": recording, **given, **told}
    missing = [o.name for o in options.values() if o.required and o.name not in arguments]
    if "path" not in options or missing:
        lacks = f"needs --set {missing[0]}=..." if missing else "has no option 'path'"
        raise typer.BadParameter(f"{cls.__name__} {lacks}")
    try:
        source = cls(**arguments)
    except ValueError as error:
        raise typer.BadParameter(f"{cls.__name__}: {error}") from None
    try:
        source.open()
        yield source
    finally:
        source.close()


def source_of(recording: Path) -> tuple[type[Source], dict[str, Any]]:
    """The class that reads a recording, by its ending, and the options that are not obvious."""
    ending = recording.suffix.lower()
    if ending == ".mcap":
        return Recording, {"topic": "lidar"}  # as the shipped rigs call theirs
    return (OusterScans if ending in SUFFIXES else KittiScans), {}


def _setting(text: str, cls: type[Source], options: Mapping[str, Option]) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals:
        raise typer.BadParameter(f"--set {text}: write name=value")
    if name not in options:
        raise typer.BadParameter(
            f"--set {text}: {cls.__name__} has no option '{name}'{suggest(name, options)}"
        )
    option = options[name]
    try:
        return name, TypeAdapter(option.annotation).validate_python(yaml.safe_load(value))
    except (yaml.YAMLError, ValidationError):
        raise typer.BadParameter(f"--set {text}: {name} takes {option.type_name}") from None
