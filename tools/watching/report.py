"""The end of a run for a person: what came out, how old it was, and what was lost and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

#: What a run of a stage with a model consists of.
STEPS = ("prepare", "infer", "finish")

#: Events that tell the story of a device or a process, and their colors.
STORY = {
    "fault": "magenta",  # on purpose
    **dict.fromkeys(("device_down", "device_hung", "process_lost", "state_reset"), "yellow"),
    **dict.fromkeys(("device_up", "process_back"), "green"),
    **dict.fromkeys(("process_failed", "process_given_up"), "red"),
}

#: The ledger's reasons (`pipeline.scheduling.events.Reason`) in a newcomer's words.
WHY = {
    "replaced": "a newer one came before the stage was free",
    "queue_full": "the queue was full",
    "passed_over": "no input set needed it",
    "decimated": "rate_hz keeps fewer",
    "not_wanted": "nothing downstream asked for it",
    "too_old": "older than max_age_ms",
    "set_skipped": "a required input was missing",
    "lost_in_transport": "lost between processes",
    "stage_stopped": "the stage had stopped",
    "end": "unused when the run ended",
}


def print_report(report: Mapping[str, Any], console: Console) -> None:
    """Print the tables of a report as `run --report` writes it."""
    console.print(
        f"\n[bold]{report['graph']}[/bold] ran {report['wall_s']:.1f} s ({report['ended']})\n"
    )
    console.print(_outputs(report["outputs"]))
    console.print(
        "Age: from the oldest sensor sample that went in until the output.\n", style="dim"
    )
    if any(device["runs"] for device in report["devices"].values()):
        console.print(_devices(report["devices"]))
        console.print("Wait: what a prepared run waits for its device.\n", style="dim")
    if again := _started_again(report.get("processes", {})):
        console.print(again, style="dim", highlight=False)
    for event in report["events"]:
        if event["kind"] in STORY:
            line = f"{event['at_s']:7.2f} s  {event['of']} {event['text']}"
            console.print(line, style=STORY[event["kind"]], highlight=False, soft_wrap=True)
    console.print(_cpu(report["stages"], report["wall_s"]))
    console.print("A run: mean CPU time, and of it the steps of a stage with a model.", style="dim")
    console.print(_beside_stages(report.get("cpu", {})), style="dim", highlight=False)
    if processes := report.get("processes"):
        console.print(_processes(processes), style="dim", highlight=False)
    lossy = {edge: book for edge, book in report["edges"].items() if any(book["dropped"].values())}
    if lossy:
        console.print(_losses(lossy))
        reasons = {
            reason for book in lossy.values() for reason, count in book["dropped"].items() if count
        }
        for reason in (reason for reason in WHY if reason in reasons):
            console.print(f"{reason}: {WHY[reason]}", style="dim", highlight=False)
        console.print()
    for name, stage in report["stages"].items():
        if stage["errors"]:
            end = ", and it stopped" if stage["stopped"] else ""
            failed = f"{name}: {stage['errors']} of {stage['runs']} runs failed{end}"
            console.print(failed, style="red")
    for link, counts in report.get("links", {}).items():
        if refused := sum((counts.get("refused") or {}).values()):
            text = f"{link}: {refused} messages refused, the last: {counts['last_refusal']}"
            console.print(text, style="red", highlight=False)
    for recording in _recordings(report):
        if incomplete := incomplete_recording(recording):
            console.print(incomplete, style="yellow", highlight=False)
    if report["ledger_balanced"]:
        console.print(
            "Every message is accounted for: used, not used as said above, or still queued."
        )
    else:
        console.print("The ledger does not balance: please report this.", style="red")


def _started_again(processes: Mapping[str, Any]) -> str:
    """Which figures above are not of the whole run: those that died with a process."""
    names = [name for name, process in processes.items() if process["restarts"]]
    if not names:
        return ""
    of = "their stages are of their" if len(names) > 1 else "its stages are of its"
    return (
        f"{' and '.join(names)} started anew: counts of messages are of the whole run; rates, "
        f"ages, device times and CPU of {of} last start.\n"
    )


def _processes(processes: Mapping[str, Any]) -> str:
    """``CPU of each process, of a core: main 52.1 %, mapping 8.4 % (1 restart).``"""
    told = []
    for name, process in processes.items():
        cores, restarts = process["cpu_cores"], process["restarts"]
        text = f"{name} not known" if cores is None else f"{name} {100 * cores:.1f} %"
        told.append(text + (f" ({restarts} restart{'s' * (restarts > 1)})" if restarts else ""))
    return f"CPU of each process, of a core: {', '.join(told)}.\n"


def _recordings(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What the recorders of the run counted, one for each process that had one."""
    parts = [report, *report.get("processes", {}).values()]
    return [part["recording"] for part in parts if "recording" in part]


def incomplete_recording(recording: Mapping[str, Any]) -> str:
    """What a recording lacks and why, in a line; empty where it has all that it was asked for."""
    path = recording["path"]
    overrun = sorted(recording["lost_buffer_full"].items(), key=lambda item: -item[1])
    lost = []
    if overrun:
        most = ", ".join(f"{count:,} {port}" for port, count in overrun[:3])
        more = ", ..." if len(overrun) > 3 else ""
        count = sum(count for _, count in overrun)
        lost.append(f"{count:,} messages or hashes ({most}{more})")
    if recording["decisions_lost"]:
        lost.append(f"{recording['decisions_lost']:,} decisions")
    told = []
    if lost:
        told.append(
            f"{path} lacks {' and '.join(lost)}: its writer had too little CPU or too slow a disk, "
            "and the run is never held back; --as-recorded may refuse it"
        )
    if unwritten := recording["lost_no_codec"]:
        told.append(
            f"{path} holds no messages of {', '.join(unwritten)}: their payload has no codec"
        )
    if recording["ended_early"]:
        told.append(f"{path} ended before the run: {recording['ended_early']}")
    return "\n".join(told)


def _outputs(outputs: Mapping[str, Any]) -> Table:
    table = Table("output", box=None, pad_edge=False, header_style="bold")
    for column in ("messages", "rate", "age p50", "age p99"):
        table.add_column(column, justify="right")
    for port, output in outputs.items():
        age = output["age_from_stamp_ms"] or {}
        table.add_row(
            port,
            str(output["count"]),
            _number(output["rate_hz"], "Hz", 1),
            _number(age.get("p50"), "ms", 0),
            _number(age.get("p99"), "ms", 0),
        )
    return table


def _devices(devices: Mapping[str, Any]) -> Table:
    table = Table("device", box=None, pad_edge=False, header_style="bold")
    for column in ("runs", "busy", "wait p50", "wait p99"):
        table.add_column(column, justify="right")
    for name, device in devices.items():
        what = f"{name}: {device['is'] or '-'}" + ("" if device["up"] else " (lost)")
        table.add_row(what, *_used(device))
        for stage, used in device["stages"].items():
            table.add_row(f"  {stage}", *_used(used), style="dim")
    return table


def _used(used: Mapping[str, Any]) -> tuple[str, ...]:
    busy, wait = used["busy_fraction"], used["wait_ms"] or {}
    return (
        str(used["runs"]),
        _number(None if busy is None else 100 * busy, "%", 1),
        _number(wait.get("p50"), "ms", 1),
        _number(wait.get("p99"), "ms", 1),
    )


def _cpu(stages: Mapping[str, Any], wall_s: float) -> Table:
    table = Table("CPU of", box=None, pad_edge=False, header_style="bold")
    for column in ("runs", "a run", *STEPS, "of a core"):
        table.add_column(column, justify="right")
    for name, stage in stages.items():
        steps = stage["cpu_ms"]
        run_ms = sum(steps.values())
        table.add_row(
            name,
            str(stage["runs"]),
            _number(run_ms if stage["runs"] else None, "ms", 2),
            *(f"{steps[step]:.2f}" if step in steps else "" for step in STEPS),
            _number(run_ms * stage["runs"] / max(wall_s, 1e-3) / 10, "%", 1),
        )
    return table


def _beside_stages(cpu: Mapping[str, Any]) -> str:
    """What the process took apart from its stages, and in all."""
    parts = [f"{name} {100 * cores:.1f} %" for name, cores in cpu.get("parts_cores", {}).items()]
    if not parts:
        return ""
    whole = f"the process in all {100 * cpu['process_cores']:.1f} % of a core"
    return f"Beside the stages: {', '.join(parts)}; {whole}.\n"


def _losses(edges: Mapping[str, Any]) -> Table:
    table = Table("input", "from", box=None, pad_edge=False, header_style="bold")
    table.add_column("messages", justify="right")
    table.add_column("used", justify="right")
    table.add_column("not used")
    for edge, book in edges.items():
        source, target = edge.split("->")
        dropped = ", ".join(
            f"{count} {reason}" for reason, count in book["dropped"].items() if count
        )
        table.add_row(
            target,
            source.removesuffix("/out"),
            str(book["produced"]),
            str(book["delivered"]),
            dropped,
        )
    return table


def _number(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"
