"""The form of a registry file: what may stand in a models.yaml, and how it is read.

It holds `models:` by name and `roots:`, folders (relative to the file) in which the files of its
variants are looked for.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.errors import ModelError

SHIPPED = Path(__file__).resolve().parents[1] / "graphs" / "models" / "models.yaml"

Color = Literal["rgb", "bgr", "gray", ""]
Layout = Literal["nhwc", "nchw"]


class Entry(BaseModel):
    """A block of a registry file: unknown keys are mistakes, values stay as read."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class InputEntry(Entry):
    """The canonical input that stages prepare."""

    name: str = "image"
    shape: tuple[int, int, int] = Field(description="height, width, channels")
    dtype: Literal["uint8", "int8", "uint16", "float32"] = "uint8"
    color: Color = ""


class HeadEntry(Entry):
    """What the outputs mean; further keys are settings that the stage of that kind understands."""

    model_config = ConfigDict(frozen=True, extra="allow")

    kind: str
    class_map: dict[int, str] = Field(default={}, description="the model's class: our class name")


class OutputEntry(Entry):
    """A canonical output: by `name` in the file (not needed where it has one output)."""

    name: str | None = None
    tensor: int | None = Field(default=None, description="cut the file here; its name beside it")
    layout: Layout = "nhwc"
    shape: tuple[int, ...] | None = Field(default=None, description="with batch; emulated: needed")
    dtype: str | None = None
    scale: float | None = None
    zero_point: int | None = None


class VariantEntry(Entry):
    """One file of a model, for devices of one kind."""

    kind: str
    file: str | None = None
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    weights: str | None = Field(default=None, description="the .bin beside an OpenVINO .xml")
    weights_sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    layout: Layout = "nhwc"
    color: Color | None = Field(default=None, description="channel order of the file, if another")
    mean: tuple[float, ...] = Field(default=(0.0,), description="in the file's channel order")
    std: tuple[float, ...] = (1.0,)
    constants: dict[str, float] = Field(default={}, description="further inputs, held at a value")
    outputs: dict[str, OutputEntry] = {}


class ModelEntry(Entry):
    """A model: what a stage sees of it, where it comes from, and its files."""

    description: str
    license: str
    source: str
    input: InputEntry
    head: HeadEntry
    variants: tuple[VariantEntry, ...] = Field(min_length=1)


class RegistryFile(Entry):
    """A registry file."""

    roots: tuple[str, ...] = (".",)
    models: dict[str, ModelEntry] = {}


def read_registry(path: Path, text: str | None = None) -> RegistryFile:
    """A registry file, or `text` as if it stood in it. Raises ModelError with the place."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8") if text is None else text)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: is not YAML: {error}") from None
    try:
        return RegistryFile.model_validate(content or {})
    except ValidationError as error:
        mistakes = (
            f"{path}: {'.'.join(map(str, one['loc'])) or 'the file'}: {one['msg']}"
            for one in error.errors()
        )
        raise ModelError("\n".join(mistakes)) from None
