"""Checks the shape of a merged file against its spec, and goes on with what is right."""

from __future__ import annotations

import json
from typing import Any

from pydantic import ValidationError

from pipeline.graph.nodes import Node, Steps
from pipeline.graph.report import Report
from pipeline.graph.spec import (
    PATTERNS,
    DeviceSpec,
    ExpectSpec,
    FaultsSpec,
    GraphSpec,
    HostSpec,
    InputExpectation,
    InputSpec,
    LinkFaultSpec,
    OutputExpectation,
    ProcessFaultSpec,
    ProcessSpec,
    QueueSpec,
    SourceFaultSpec,
    Spec,
    StageSpec,
)
from pipeline.graph.wording import explain, shown, suggest

_ANY = "*"
_SPECS: dict[Steps, type[Spec]] = {
    (): GraphSpec,
    ("devices", _ANY): DeviceSpec,
    ("stages", _ANY): StageSpec,
    ("stages", _ANY, "inputs", _ANY): InputSpec,
    ("stages", _ANY, "inputs", _ANY, "queue"): QueueSpec,
    ("processes", _ANY): ProcessSpec,
    ("hosts", _ANY): HostSpec,
    ("faults",): FaultsSpec,
    ("faults", "sources", _ANY): SourceFaultSpec,
    ("faults", "processes", _ANY): ProcessFaultSpec,
    ("faults", "links", _ANY): LinkFaultSpec,
    ("expect",): ExpectSpec,
    ("expect", "outputs", _ANY): OutputExpectation,
    ("expect", "inputs", _ANY): InputExpectation,
}
_REQUIRED: dict[str, tuple[Any, str]] = {
    "overflight": (1, "begin it with 'overflight: 1', the version of the format"),
    "graph": ("?", "give the graph a name"),
    "stages": ({}, "there is nothing to run"),
}

#: Words that people bring from elsewhere, and the keys that are meant here.
_MEANT = {
    **dict.fromkeys(("on", "device", "accelerator", "runs_on"), ("executor",)),
    **dict.fromkeys(("class", "type", "module"), ("use",)),
    **dict.fromkeys(("params", "args", "variables"), ("options", "parameters")),
    **dict.fromkeys(("source", "topic", "stage"), ("from",)),
    **dict.fromkeys(("queue_size", "queue_policy", "buffer"), ("queue",)),
    **dict.fromkeys(("nodes", "operators"), ("stages",)),
    **dict.fromkeys(("slop_ms", "threshold_ms"), ("tolerance_ms",)),
    **dict.fromkeys(("timeout_ms", "wait_ms"), ("max_wait_ms",)),
}


def check_shape(tree: Node, report: Report) -> tuple[GraphSpec, frozenset[Steps]]:
    """The file as specs, without the entries that are wrong; those are reported.

    The second value names every spec that lost an entry: what follows from that (a missing
    tolerance, no trigger) is no further mistake.
    """
    data = _without_nulls(tree.plain(), ())
    damaged: set[Steps] = set()
    for key, (_, way_out) in _REQUIRED.items():
        if not data.get(key):
            report.mistake((), f"misses '{key}'; {way_out}")
    while True:
        for key, (default, _) in _REQUIRED.items():
            data.setdefault(key, default)
        try:
            spec = GraphSpec.model_validate_json(json.dumps(data), strict=True)
            return spec, frozenset(damaged)
        except ValidationError as error:
            errors = error.errors()
            unknown = {e["loc"] for e in errors if e["type"] == "extra_forbidden"}
            misnamed = {e["loc"][:-1] for e in errors if e["loc"][-1] == "[key]"}
            wrong: set[Steps] = set()
            # A key that was cut in an earlier round is wrong, not missing.
            lost = {
                e["loc"][:-1] for e in errors if e["type"] == "missing" and _holds(tree, e["loc"])
            }
            for steps, sentence in explain(errors, data, PATTERNS):
                owner = _owner(steps)
                if steps in unknown:
                    sentence = _unknown_key(steps)
                elif steps == ("overflight",):
                    sentence = f"this Overflight reads format 1, not {shown(data['overflight'])}"
                elif sentence.startswith("expected a mapping"):
                    sentence += _short_form(tree, steps)
                if steps not in lost:
                    report.mistake(steps, sentence, at_key=steps in unknown | misnamed)
                damaged.add(owner)
                wrong.add(steps[: len(owner) + 1])
            for steps in wrong:
                _cut(data, steps)


def _owner(steps: Steps) -> Steps:
    """The innermost spec that holds the value at `steps`."""
    return max(
        (steps[: len(pattern)] for pattern in _SPECS if _fits(steps[: len(pattern)], pattern)),
        key=len,
    )


def _fits(steps: Steps, pattern: Steps) -> bool:
    return len(steps) == len(pattern) and all(
        wanted in (_ANY, step) for step, wanted in zip(steps, pattern, strict=True)
    )


def _keys(spec: type[Spec]) -> list[str]:
    return [field.alias or name for name, field in spec.model_fields.items()]


def _spec_at(steps: Steps) -> type[Spec] | None:
    return next((spec for pattern, spec in _SPECS.items() if _fits(steps, pattern)), None)


def _without_nulls(value: Any, steps: Steps) -> Any:
    """A key of ours with nothing behind it counts as not written."""
    if not isinstance(value, dict) or len(steps) > 5:
        return value
    spec = _spec_at(steps)
    keys = _keys(spec) if spec else ()
    return {
        key: _without_nulls(child, (*steps, key))
        for key, child in value.items()
        if child is not None or key not in keys
    }


def _unknown_key(steps: Steps) -> str:
    key = str(steps[-1])
    spec = _spec_at(steps[:-1])
    assert spec is not None
    keys = _keys(spec)
    meant = next((word for word in _MEANT.get(key, ()) if word in keys), None)
    way_out = f"; did you mean '{meant}'?" if meant else suggest(key, keys, or_list=False)
    if not way_out and spec is StageSpec:
        way_out = "; options of the class stand under 'options'"
    return f"unknown key '{key}'{way_out or suggest('', keys)}"


def _holds(tree: Node, steps: Steps) -> bool:
    node = tree.get(*steps)
    return node is not None and node.value is not None


def _short_form(tree: Node, steps: Steps) -> str:
    """How to write a mapping for one who wrote only its chief value."""
    node, spec = tree.get(*steps), _spec_at(steps)
    if spec is InputSpec:
        return "; write a stage, a list of stages, or {from: ...}"
    if spec in (StageSpec, DeviceSpec) and node is not None and isinstance(node.value, str):
        return f"; write {{use: {node.value}}}"
    return ""


def _cut(data: dict[str, Any], steps: Steps) -> None:
    *holders, last = steps
    for step in holders:
        data = data.get(str(step), {})
    data.pop(str(last), None)
