"""Checks that what a file expects is expected of something that is there."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.graph.contract import Contract
from pipeline.graph.report import Report
from pipeline.graph.spec import ExpectSpec
from pipeline.graph.wording import suggest


def check_expect(
    spec: ExpectSpec, contracts: Mapping[str, Contract | None], report: Report
) -> ExpectSpec:
    """The same with every output as ``stage/port``.

    `contracts` are all stages that the file names, None where one is wrong.
    """
    known = {name: contract for name, contract in contracts.items() if contract is not None}
    unread = contracts.keys() - known.keys()
    outputs = [f"{name}/{port.name}" for name, c in known.items() for port in c.outputs]
    inputs = [f"{name}/{port.name}" for name, c in known.items() for port in c.inputs]
    spoken = [*outputs, *(output.removesuffix("/out") for output in outputs)]
    for kind, given, there in (("output", spec.outputs, spoken), ("input", spec.inputs, inputs)):
        for name in given:
            if name not in there and name.partition("/")[0] not in unread:
                what = f"no {kind} '{name}'{suggest(name, there)}"
                report.mistake(("expect", f"{kind}s", name), what, at_key=True)
    full = {name if "/" in name else f"{name}/out": rule for name, rule in spec.outputs.items()}
    return spec.model_copy(update={"outputs": full})
