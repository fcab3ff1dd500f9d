"""Writes models into a registry file, and leaves the file alone where anything is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from accelerators.registry import Registry
from accelerators.registry_file import read_registry
from pipeline.errors import ModelError
from tools.models.entry import Said, Written, entry_of
from tools.models.registry_text import with_entry


def add_model(
    name: str, files: Sequence[Path], said: Said, registry: Path, *, replace: bool
) -> tuple[Written, bool]:
    """Write the entry of a model with these files as its variants; also, whether it replaced one.

    Raises ModelError where the name is taken and `replace` is not set, or a file cannot be read.
    """
    _refuse_shipped(name, replace=replace)
    content = read_registry(registry, _text(registry))
    written = entry_of(files, said, [registry.parent / root for root in content.roots])
    write_entry(registry, name, written.entry, replace=replace)
    return written, name in content.models


def write_entry(
    registry: Path, name: str, entry: Mapping[str, Any], *, replace: bool, known: int = 0
) -> None:
    """Put the entry into the file, once it was read back and held against its model files.

    The first `known` variants are of another registry, whose files may lie elsewhere or nowhere.
    Raises ModelError.
    """
    after = with_entry(_text(registry), name, entry, registry, replace=replace)
    content = read_registry(registry, after)
    models = Registry.of(content, registry.parent)
    for variant in content.models[name].variants[known:]:
        models.check_variant(name, variant)
    _write(registry, after)


def _refuse_shipped(name: str, *, replace: bool) -> None:
    if not replace and name in Registry.open().names():
        raise ModelError(
            f"a model '{name}' ships with Overflight; take another name, or --replace makes yours "
            "hide it where --models names your file"
        )


def _text(registry: Path) -> str:
    try:
        return registry.read_text(encoding="utf-8") if registry.exists() else ""
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{registry}: cannot be read ({error})") from None


def _write(registry: Path, text: str) -> None:
    """Write the file as a whole."""
    try:
        registry.parent.mkdir(parents=True, exist_ok=True)
        beside = registry.with_name(registry.name + ".new")
        beside.write_text(text, encoding="utf-8")
        beside.replace(registry)
    except OSError as error:
        raise ModelError(f"{registry}: cannot be written ({error.strerror})") from None
