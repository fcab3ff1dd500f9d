"""Checks which stage runs which model on which device."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from pipeline.graph.catalog import Catalog
from pipeline.graph.contract import Contract
from pipeline.graph.nodes import Steps
from pipeline.graph.parts import Part
from pipeline.graph.report import Report
from pipeline.graph.spec import StageSpec
from pipeline.graph.wording import suggest
from pipeline.model import Accelerator


def check_binding(
    name: str,
    spec: StageSpec,
    contract: Contract,
    devices: Mapping[str, Part[Accelerator] | None],
    catalog: Catalog,
    damaged: Collection[Steps],
    report: Report,
) -> None:
    """Report where executor and model of a stage do not go with its class or each other.

    `devices` are all that the file names, None where one is wrong.
    """
    steps: Steps = ("stages", name)
    if not contract.is_model:
        for key in ("executor", "model", "timeout_ms", "degraded_rate_hz"):
            if getattr(spec, key) is not None:
                what = f"{spec.use} is no ModelStage: it runs on the CPU by itself; remove '{key}'"
                report.mistake((*steps, key), what, at_key=True)
        return
    if steps not in damaged:
        if spec.model is None:
            what = f"{spec.use} runs a model; name it under 'model'"
            report.mistake(steps, what + suggest("", catalog.names()))
        if spec.executor is None:
            what = f"{spec.use} runs a model; name its device under 'executor'"
            report.mistake(steps, what + suggest("", devices))
    if spec.degraded_rate_hz is not None and len(spec.executor or ()) < 2:
        what = "'degraded_rate_hz' is for the lower rungs of 'executor', which has none"
        report.mistake((*steps, "degraded_rate_hz"), what, at_key=True)
    known_model = spec.model is not None and spec.model in catalog.names()
    if spec.model is not None and not known_model:
        what = f"no model '{spec.model}'{suggest(spec.model, catalog.names())}"
        report.mistake((*steps, "model"), what)
    seen: set[str] = set()
    for number, device in enumerate(spec.executor or ()):
        place = (*steps, "executor", number)
        if device not in devices:
            report.mistake(place, f"no device '{device}'{suggest(device, devices)}")
        elif device in seen:
            report.mistake(place, f"'{device}' is in this list twice")
        elif known_model and (part := devices[device]) is not None and part.instance is not None:
            assert spec.model is not None
            if (why_not := catalog.check(spec.model, part.instance)) is not None:
                report.mistake(place, f"'{device}': {why_not}")
        seen.add(device)
