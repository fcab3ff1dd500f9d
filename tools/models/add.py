"""Adds a model to a registry file, and leaves the file alone where anything is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
    before = _text(registry)
    _refuse_shipped(name, replace=replace)
    content = read_registry(registry, before)
    written = entry_of(files, said, [registry.parent / root for root in content.roots])
    after = with_entry(before, name, written.entry, registry, replace=replace)
    _write_if_sound(registry, after, name)
    return written, name in content.models


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


def _write_if_sound(registry: Path, text: str, name: str) -> None:
    """Write the file as a whole, once the new entry was read back and held against its files."""
    content = read_registry(registry, text)
    models = Registry.of(content, registry.parent)
    for variant in content.models[name].variants:
        models.check_variant(name, variant)
    try:
        registry.parent.mkdir(parents=True, exist_ok=True)
        beside = registry.with_name(registry.name + ".new")
        beside.write_text(text, encoding="utf-8")
        beside.replace(registry)
    except OSError as error:
        raise ModelError(f"{registry}: cannot be written ({error.strerror})") from None
