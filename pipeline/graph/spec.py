"""The graph file's keys, what each takes and what it means; the JSON schema is made of this."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from pipeline.scheduling.topology import Missing, OnError, Policy, Sync

_MAX_MS = 86_400_000  #: a day; nothing in a graph waits longer
_NAME = r"^[A-Za-z_][A-Za-z0-9_-]*$"
_PARAMETER = r"^[A-Za-z_][A-Za-z0-9_]*$"
_USE = r"^[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*:[A-Za-z_][A-Za-z0-9_]*$"

#: What a text that does not match one of these patterns should have been.
PATTERNS = {
    _NAME: "is no name; use letters, digits, '_' and '-', and a letter first",
    _PARAMETER: "is no name of a parameter; use letters, digits and '_', and a letter first",
    _USE: "names no class; write module:Class",
}

Name = Annotated[str, Field(pattern=_NAME)]
Use = Annotated[str, Field(pattern=_USE)]
Milliseconds = Annotated[float, Field(ge=0, le=_MAX_MS)]


class Spec(BaseModel):
    """A mapping of the file with keys of its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class QueueSpec(Spec):
    """What waits between an output and the stage that it triggers."""

    policy: Policy = Field(
        Policy.LATEST,
        description="What a full queue does: latest (keep one, the newest), drop_oldest, "
        "drop_newest, or block (hold the producer back).",
    )
    size: int = Field(1, ge=1, le=100_000, description="How many messages may wait.")


class InputSpec(Spec):
    """An input port: where its messages come from and how they take part in a run."""

    source: tuple[str, ...] = Field(
        alias="from",
        min_length=1,
        description="The output that feeds it: a stage, or stage/port. A list where the port "
        "takes several edges.",
    )
    sync: Sync = Field(
        Sync.TRIGGER,
        description="trigger (default): its messages start the runs. exact: the message of the "
        "trigger's stamp. nearest: the nearest within tolerance_ms. latest: the last one at or "
        "before the trigger. span: all messages around the set.",
    )
    select: str | None = Field(
        None,
        min_length=1,
        description="Trigger only: inputs of one output with the same word take the same frames.",
    )
    tolerance_ms: Milliseconds | None = Field(
        None, description="nearest: the furthest stamp from the trigger's, inclusive."
    )
    offset_ms: Annotated[float, Field(ge=-_MAX_MS, le=_MAX_MS)] | None = Field(
        None, description="Added to this input's stamps before they are compared."
    )
    max_wait_ms: Milliseconds | None = Field(
        None,
        description="How long a set waits for this input, from the trigger's arrival. Default 200 "
        "for nearest and span, twice the trigger's period for exact.",
    )
    max_age_ms: Milliseconds | None = Field(
        None, description="Trigger only: a message older than this is dropped before it costs work."
    )
    missing: Missing | None = Field(
        None,
        description="Without a message: proceed (None; the default where the port may be None), "
        "hold (the last one, up to hold_ms old), or skip (drop the set; the default otherwise).",
    )
    hold_ms: Milliseconds | None = Field(
        None, description="missing: hold: how old the held message may be."
    )
    queue: QueueSpec | None = Field(
        None, description="Trigger only: what waits for the stage. Default: the latest message."
    )
    rate_hz: Annotated[float, Field(ge=0.001, le=1_000_000)] | None = Field(
        None, description="Let through at most so many messages a second, evenly by stamp."
    )
    compress: Annotated[str, Field(pattern=rf"^zstd$|{_USE}")] | None = Field(
        None,
        description="To another host only: zstd (lossless), or a compressor of the payload as "
        "module:Class, such as stages.codecs.lossy:Jpeg.",
    )


class StageSpec(Spec):
    """A stage: a class, its options, its inputs, and the device it runs on."""

    use: Use = Field(description="The class, as module:Class.")
    options: Mapping[str, Any] = Field(
        default_factory=dict, description="What the class takes: see `overflight inspect`."
    )
    executor: tuple[str, ...] | None = Field(
        None,
        min_length=1,
        description="The device, or a list to degrade along: the first is preferred.",
    )
    model: str | None = Field(None, description="A name in the model registry.")
    inputs: Mapping[str, InputSpec] = Field(
        default_factory=dict,
        description="Where each input port's messages come from. Short form: image: rgb.",
    )
    on_error: OnError | None = Field(
        None, description="A failed run: stop the stage (default), or skip it and count."
    )
    priority: Annotated[int, Field(ge=-1000, le=1000)] | None = Field(
        None, description="Higher first on a shared device or core. Default 0."
    )
    max_in_flight: Annotated[int, Field(ge=1, le=64)] | None = Field(
        None, description="Runs started and not finished. Default 1, with a model 2."
    )
    run: Literal["every", "wanted"] | None = Field(
        None,
        description="every (default): each trigger that finds the stage free. wanted: those that "
        "an input downstream will choose, as far as their stamps can be predicted.",
    )
    process: Name | None = Field(
        None,
        description="The process that it runs in, by any name: stages of one name share one. "
        "Default: the main process. See `processes` for more.",
    )
    timeout_ms: Annotated[float, Field(gt=0, le=_MAX_MS)] | None = Field(
        None,
        description="An infer that takes longer marks its device as lost. Default: ten times the "
        "longest of the last ones.",
    )
    degraded_rate_hz: Annotated[float, Field(ge=0.001, le=1_000_000)] | None = Field(
        None, description="At most so many runs a second on a lower rung of the executor's list."
    )
    min_period_ms: Annotated[float, Field(gt=0, le=_MAX_MS)] | None = Field(
        None,
        description="Sources only: the promise that stamps lie at least so far apart; others then "
        "wait less for this stream.",
    )


class DeviceSpec(Spec):
    """A device: the accelerator class, and its options beside it."""

    model_config = ConfigDict(frozen=True, extra="allow")

    use: Use = Field(description="The accelerator class, as module:Class.")
    isolate: bool | None = Field(
        None,
        description="In a process of its own, which may crash or hang and is started anew. "
        "Default: what the class says; EdgeTpu says true.",
    )
    restart_policy: Literal["never", "on-failure", "always"] | None = Field(
        None,
        description="isolate: whether its process is started anew: after a crash (on-failure, the "
        "default), also when it ended by itself (always), or never.",
    )
    max_restarts: Annotated[int, Field(ge=0, le=1_000_000)] | None = Field(
        None, description="isolate: at most so many restarts within restart_window_s. Default 5."
    )
    restart_window_s: Annotated[float, Field(gt=0, le=_MAX_MS / 1e3)] | None = Field(
        None, description="isolate: see max_restarts. Default 60."
    )


class ProcessSpec(Spec):
    """A process of the graph: where it runs, and what is done when it ends."""

    host: Name | None = Field(
        None,
        description="The host that it runs on, a name under `hosts`: started there by "
        "`overflight run --host NAME`.",
    )
    affinity: tuple[Annotated[int, Field(ge=0, le=4095)], ...] | None = Field(
        None, min_length=1, description="The cores that it may use, from 0. Default: all."
    )
    nice: Annotated[int, Field(ge=-20, le=19)] | None = Field(
        None, description="Its niceness: above 0 it gives way to others. Default 0."
    )
    restart_policy: Literal["never", "on-failure", "always"] | None = Field(
        None,
        description="Whether it is started anew: after a crash or a kill (on-failure, the "
        "default), also when it ended by itself (always), or never.",
    )
    max_restarts: Annotated[int, Field(ge=0, le=1_000_000)] | None = Field(
        None, description="At most so many restarts within restart_window_s. Default 5."
    )
    restart_window_s: Annotated[float, Field(gt=0, le=_MAX_MS / 1e3)] | None = Field(
        None, description="See max_restarts. Default 60."
    )


class HostSpec(Spec):
    """A host of the graph; its processes are started there by `overflight run --host NAME`."""

    listen: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        (),
        description="Endpoints at which other hosts find it, e.g. tcp/192.168.1.10:7447; each "
        "further process of the host takes the next port. Nothing is open without them.",
    )
    reach: tuple[Annotated[str, Field(min_length=1)], ...] | None = Field(
        None, min_length=1, description="How others reach it, where that is not `listen`."
    )
    zenoh: Mapping[str, Any] = Field(
        default_factory=dict,
        description="Zenoh's own keys between hosts, as in its documentation: "
        "transport/link/tls, transport/auth/usrpwd, access_control.",
    )


Seconds = Annotated[float, Field(ge=0, le=_MAX_MS / 1e3)]


class SourceFaultSpec(Spec):
    """What goes wrong with a source. Seconds count from the graph's first sample."""

    dies_at_s: Seconds | None = Field(None, description="Nothing comes from here on.")
    returns_at_s: Seconds | None = Field(
        None, description="Until here; without it the source stays dead."
    )
    repeats_at_s: Seconds | None = Field(
        None, description="The last message comes again here, with the same stamp."
    )
    jumps_at_s: Seconds | None = Field(
        None, description="Its clock jumps: stamps from here on are shifted by jumps_by_ms."
    )
    jumps_by_ms: Annotated[float, Field(ge=-_MAX_MS, le=_MAX_MS)] | None = Field(
        None, description="jumps_at_s: by so much; below 0 backward."
    )
    stalls_at_s: Seconds | None = Field(
        None, description="What comes from here on is held up, and arrives stalls_for_s later."
    )
    stalls_for_s: Seconds | None = Field(
        None, description="stalls_at_s: for so long; then all of it arrives at once."
    )


class ProcessFaultSpec(Spec):
    """What goes wrong with a process."""

    killed_at_s: tuple[Seconds, ...] = Field(
        (), min_length=1, description="It gets SIGKILL then, as often as times are listed."
    )


class LinkFaultSpec(Spec):
    """What goes wrong with the way of a port's messages to other processes, on the wire."""

    cut_at_s: Seconds | None = Field(None, description="Nothing gets through from here on.")
    restored_at_s: Seconds | None = Field(
        None, description="Until here; without it the link stays cut."
    )
    delay_ms: Milliseconds | None = Field(None, description="Everything arrives so much later.")
    drops: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="The share of messages that are lost, drawn by the seed."
    )


class FaultsSpec(Spec):
    """What goes wrong and when, to see what the graph does then; mostly in an overlay."""

    sources: Mapping[Name, SourceFaultSpec] = Field(
        default_factory=dict, description="By source: it dies, returns, repeats, jumps, stalls."
    )
    processes: Mapping[Name, ProcessFaultSpec] = Field(
        default_factory=dict, description="By process: it is killed."
    )
    links: Mapping[str, LinkFaultSpec] = Field(
        default_factory=dict,
        description="By output (a stage, or stage/port) that other processes read: it is cut or "
        "slow, or loses messages.",
    )
    seed: Annotated[int, Field(ge=0)] = Field(0, description="Of what is drawn at random.")


#: Keys of a device block that are ours, not options of its class.
DEVICE_KEYS = tuple(DeviceSpec.model_fields)


class OutputExpectation(Spec):
    """What an output must keep to."""

    min_rate_hz: Annotated[float, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="Messages a second, at least."
    )
    max_age_ms: Milliseconds | None = Field(
        None,
        description="At most so old, for 99 of 100 messages: from the oldest sensor sample that "
        "went in.",
    )
    max_gap_ms: Milliseconds | None = Field(
        None, description="The longest silence between two messages."
    )


class InputExpectation(Spec):
    """What an input must keep to, each of its edges for itself."""

    max_drop_percent: Annotated[float, Field(ge=0, le=100)] | None = Field(
        None,
        description="Of the messages that come, at most so many lost. What the graph leaves out on "
        "purpose (rate_hz, run: wanted, no set needs it) is not lost.",
    )


class ExpectSpec(Spec):
    """What a run must keep to: checked at its end and by `overflight check`."""

    outputs: Mapping[str, OutputExpectation] = Field(
        default_factory=dict, description="By output: a stage, or stage/port."
    )
    inputs: Mapping[str, InputExpectation] = Field(
        default_factory=dict, description="By input: stage/input."
    )
    max_cpu_cores: Annotated[float, Field(gt=0, le=100_000)] | None = Field(
        None, description="CPU of the whole process, in cores, on average over the run."
    )


class GraphSpec(Spec):
    """A graph of stages, bound to devices."""

    overflight: Literal[1] = Field(description="The version of this file format.")
    graph: Annotated[str, Field(min_length=1, description="The name of the graph.")]
    include: tuple[str, ...] = Field(
        (), description="Files that lie under this one; what stands here wins."
    )
    parameters: Mapping[Annotated[str, Field(pattern=_PARAMETER)], Any] = Field(
        default_factory=dict,
        description="Values that $name stands for; change them with --set parameters.name=value.",
    )
    devices: Mapping[Name, DeviceSpec] = Field(
        default_factory=dict, description="The hardware, by the names that executors use."
    )
    calibration: Mapping[str, Any] | None = Field(
        None, description="The sensors by name, or {use: module:function, options: {...}}."
    )
    stages: Mapping[Name, StageSpec] = Field(description="The stages by name.")
    processes: Mapping[Name, ProcessSpec] = Field(
        default_factory=dict,
        description="The processes that stages name with `process`; the others are in `main`.",
    )
    hosts: Mapping[Name, HostSpec] = Field(
        default_factory=dict,
        description="The hosts that processes name with `host`; without them all run on this one.",
    )
    faults: FaultsSpec = Field(
        default_factory=lambda: FaultsSpec.model_validate({}),
        description="What goes wrong in this run, and when. Of emulated devices: "
        "devices.NAME.faults.",
    )
    expect: ExpectSpec = Field(
        default_factory=lambda: ExpectSpec.model_validate({}),
        description="What a run must keep to, or it has failed.",
    )


def graph_schema() -> dict[str, Any]:
    """The JSON schema of the graph file, for editors: completion, hover text, red lines."""
    schema = GraphSpec.model_json_schema()
    stage = schema["$defs"]["StageSpec"]["properties"]
    source = schema["$defs"]["InputSpec"]["properties"]["from"]
    stage["inputs"]["additionalProperties"]["anyOf"] = [
        *_ONE_OR_MORE,
        {"$ref": stage["inputs"]["additionalProperties"].pop("$ref")},
    ]
    for short_form in (source, stage["executor"]):
        description = short_form["description"]
        short_form.clear()
        short_form |= {"description": description, "anyOf": _ONE_OR_MORE}
    schema["properties"]["stages"]["minProperties"] = 1
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **_for_editors(schema),
        "title": "Overflight graph file",
    }


_ONE_OR_MORE = [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]


def _for_editors(schema: Any, *, names: bool = False) -> Any:
    """Without pydantic's titles and nulls, and with ``$name`` wherever a value may stand.

    `names`: the keys of this mapping are names of the file, not words of JSON schema.
    """
    if isinstance(schema, list):
        return [_for_editors(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    made = {
        key: _for_editors(value, names=not names and key in ("properties", "$defs"))
        for key, value in schema.items()
        if names or (key != "title" and (key, value) != ("default", None))
    }
    if names:
        return made
    if "anyOf" in made:
        made["anyOf"] = [option for option in made["anyOf"] if option != {"type": "null"}]
        if len(made["anyOf"]) == 1:
            made |= made.pop("anyOf")[0]
    if "patternProperties" in made:
        made["additionalProperties"] = False
    if "enum" in made or (made.get("type") in ("number", "integer") and "const" not in made):
        value = {key: made.pop(key) for key in list(made) if key not in ("description", "default")}
        made["anyOf"] = [value, {"type": "string", "pattern": r"^\$"}]
    return made
