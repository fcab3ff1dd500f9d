"""What is different between the run that was recorded and the one that shall repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from pipeline.recording.manifest import Manifest
from pipeline.recording.reenactment import shown
from pipeline.scheduling.topology import Topology


def rules_differ(recorded: Topology, here: Topology) -> str | None:
    """The first difference that would change a decision, in words; None where there is none.

    The number of CPU workers is the machine's; a replay takes the recorded one.
    """
    names = [stage.name for stage in recorded.stages]
    names_here = [stage.name for stage in here.stages]
    for name in (*names, *names_here):
        if (name in names) != (name in names_here):
            where = "in the recording" if name in names else "here"
            return f"stages.{name}: only {where}"
    if names != names_here:
        return f"the stages stand in another order: {shown(names)} in the recording"
    if recorded.check_every != here.check_every:
        return f"check_every: {recorded.check_every} in the recording, {here.check_every} here"
    for one, two in zip(recorded.stages, here.stages, strict=True):
        for place, before, now in _differences(one, two, f"stages.{one.name}"):
            return f"{place}: {before} in the recording, {now} here"
    return None


def surroundings_differ(
    recorded: Manifest, versions: Mapping[str, str], machine: Mapping[str, str]
) -> list[str]:
    """Why outputs may differ in their last bits: versions, CPU, threads; empty where nothing is."""
    found = [
        f"{name} {recorded.versions.get(name, 'absent')} in the flight, {version} here"
        for name, version in versions.items()
        if recorded.versions.get(name) != version
    ]
    for name, value in machine.items():
        before = recorded.machine.get(name, "unknown")
        if before == value:
            continue
        if name == "features":
            missing = sorted(set(before.split()) - set(value.split()))
            added = sorted(set(value.split()) - set(before.split()))
            parts = [f"without {' '.join(missing)}"] if missing else []
            parts += [f"with {' '.join(added)}"] if added else []
            found.append(f"CPU features: here {' and '.join(parts)}")
        else:
            found.append(f"{name}: {before} in the flight, {value} here")
    return found


def options_differ(recorded: Manifest, here: Manifest) -> list[str]:
    """Options of stages and devices that are not as recorded."""
    found: list[str] = []
    for kind in ("options", "executors"):
        before, now = getattr(recorded, kind), getattr(here, kind)
        for name, values in now.items():
            for key, value in values.items():
                was = before.get(name, {}).get(key, "absent")
                if was != value:
                    found.append(f"{name}.{key}: {was} in the flight, {value} here")
    return found


def _differences(one: Any, two: Any, place: str) -> Iterator[tuple[str, Any, Any]]:
    if type(one) is type(two) and is_dataclass(one):
        for field in fields(one):
            before, now = getattr(one, field.name), getattr(two, field.name)
            yield from _differences(before, now, f"{place}.{field.name}")
    elif isinstance(one, tuple) and isinstance(two, tuple) and len(one) == len(two):
        for number, (before, now) in enumerate(zip(one, two, strict=True)):
            name = getattr(before, "name", number)
            yield from _differences(before, now, f"{place}.{name}")
    elif one != two:
        yield place, one, two
