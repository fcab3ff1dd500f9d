"""Model files held against the registry, and loaded on whatever this machine can run them on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.table import Table

from accelerators.litert import EdgeTpu, TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.registry import Registry
from accelerators.registry_file import VariantEntry
from pipeline.errors import OverflightError
from pipeline.model import Accelerator


@dataclass(frozen=True, slots=True)
class Finding:
    """What is to be said of one file of a model, on one device that runs it (or none)."""

    model: str
    kind: str
    file: str
    device: str  #: empty where no device of this machine runs such a file
    state: str  #: well, missing or wrong
    said: str  #: one sentence


def computing_devices() -> Iterator[Accelerator]:
    """Every device of this machine that computes, opened by its own class."""
    for cls in (TfliteCpu, EdgeTpu, OpenVino, Onnx):
        for options in cls.candidates():
            device = cls(**options)
            if device.probe().available:
                yield device


def findings_of(
    registry: Registry, model: str, variant: VariantEntry, devices: Sequence[Accelerator]
) -> Iterator[Finding]:
    """What is to be said of one variant: of its files, then of each device that can run them."""

    def finding(state: str, said: str, device: str = "") -> Finding:
        return Finding(model, variant.kind, variant.file or "", device, state, said)

    if variant.file is None:
        yield finding("well", "has no file")
        return
    state = "missing" if registry.find(variant.file) is None else "wrong"
    try:
        registry.check_variant(model, variant)
    except OverflightError as error:
        yield finding(state, str(error))
        return
    able = [device for device in devices if variant.kind in device.kinds]
    if not able:
        yield finding("well", f"fits its entry; nothing on this machine runs {variant.kind} files")
    for device in able:
        probe = device.probe()
        where = f"{probe.runtime}, {probe.name}"
        try:
            registry.load(model, device, variant)
        except OverflightError as error:
            yield finding("wrong", str(error), where)
        else:
            yield finding("well", "fits its entry, loads and runs", where)


def findings_table(findings: Sequence[Finding]) -> Table:
    """The findings for a person; what is wrong with a file stands elsewhere in full."""
    colors = {"well": "green", "missing": "yellow", "wrong": "red"}
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("model", "kind", "device", ""):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("model", "kind"))
    for finding in findings:
        said = finding.said if finding.state == "well" else finding.state
        table.add_row(
            finding.model, finding.kind, finding.device, said, style=colors[finding.state]
        )
    return table
