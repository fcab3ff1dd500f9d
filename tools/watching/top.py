"""`overflight top`: how a graph that runs in another shell stands, as it says itself."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import typer
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from pipeline.errors import DataError
from pipeline.measuring.board import boards, read_board

Page: TypeAlias = Mapping[str, Any]

PERIOD_S = 0.5
EVENTS_SHOWN = 6
#: An output is overdue after so many of its periods, but not before the least time.
OVERDUE_PERIODS, OVERDUE_LEAST_S = 3, 0.5


def watch(which: str | None, *, once: bool = False, as_json: bool = False) -> None:
    """Show a run until it ends or Ctrl-C; with `once` as it stands now.

    `which` is a graph's name or a process id; without it there should be one run. Several that fit
    are listed. Raises DataError where none fits.
    """
    fitting = find(which)
    if len(fitting) > 1:
        names = ", ".join(f"{page['graph']} (process {page['pid']})" for page in fitting.values())
        if as_json:
            raise DataError(f"several graphs run: {names}; say which: overflight top PROCESS")
        Console().print(listed(list(fitting.values())), soft_wrap=True)
        return
    [(path, page)] = fitting.items()
    try:
        if as_json:
            _stream(path, page, once=once)
        elif once or not Console().is_terminal:
            Console().print(screen(page))
        else:
            _live(path, page)
    except KeyboardInterrupt:
        pass


def find(which: str | None) -> Mapping[Path, Page]:
    """The pages of the runs that fit, by their file. Raises DataError where none does."""
    try:
        pages = {path: page for path in boards() if (page := read_board(path)) is not None}
    except OSError as error:
        raise DataError(f"cannot look for running graphs: {error}") from None
    if not pages:
        raise DataError("no graph runs here; start one in another shell: overflight run GRAPH")
    fitting = {
        path: page
        for path, page in pages.items()
        if which is None or which in (page["graph"], str(page["pid"]))
    }
    if not fitting:
        known = ", ".join(f"{page['graph']} (process {page['pid']})" for page in pages.values())
        raise DataError(f"no running graph '{which}'; there are {known}")
    return fitting


def _stream(path: Path, page: Page, *, once: bool) -> None:
    """One line of JSON per page until the run ends; with `once` a single page, indented."""
    if once:
        typer.echo(json.dumps(page, indent=2))
        return
    following: Page | None = page
    while following is not None:
        typer.echo(json.dumps(following))
        time.sleep(PERIOD_S)
        following = read_board(path)


def _live(path: Path, page: Page) -> None:
    with Live(screen=True, auto_refresh=False) as live:
        while (following := read_board(path)) is not None:
            page = following
            live.update(fitted(page, live.console), refresh=True)
            time.sleep(PERIOD_S)
    Console().print(screen(page), Text("The run is over."))


# ---------------------------------------------------------------------- what is shown


def listed(pages: Sequence[Page]) -> RenderableType:
    """Several runs, and how to see one of them."""
    table = _table("graph", "process", "state", "for", "CPU")
    for page in pages:
        table.add_row(
            page["graph"],
            str(page["pid"]),
            page["state"],
            _for(page),
            _percent(page.get("cpu_cores")),
        )
    return Group(table, Text("Say which: overflight top GRAPH or overflight top PROCESS"))


def fitted(page: Page, console: Console) -> RenderableType:
    """One run; in brief where all of it is higher than the terminal, which would cut off the ages
    of the last outputs and the devices."""
    whole = screen(page)
    if len(console.render_lines(whole, pad=False)) <= console.height:
        return whole
    return screen(page, brief=True)


def screen(page: Page, *, brief: bool = False) -> RenderableType:
    """One run. In brief: the sensors in a line, the ages of the last outputs alone."""
    head = Text.assemble(
        (page["graph"], "bold"), f"   process {page['pid']}   {page['state']} for {_for(page)}"
    )
    if page["state"] == "opening":
        return Group(head, Text("Devices, models and stages are being opened."))
    speed = page["speed"]
    if speed != 1.0:
        head.append("   offline" if speed == "max" else f"   {speed:g} x real time")
    head.append(f"   CPU {_percent(page['cpu_cores'])} of a core")
    parts: list[RenderableType] = [head, Text()]
    if brief:
        parts.append(_sensors(page))
    parts += [_stages(page, brief), Text(), *_ages(page, brief)]
    if page["devices"]:
        parts += [_devices(page["devices"], brief), Text()]
    parts += [Text(failure, "red") for failure in page["failures"]]
    parts += [_event(event) for event in page["events"][-EVENTS_SHOWN:]]
    return Group(*parts)


def _is_sensor(stage: Page) -> bool:
    return "queued" not in stage


def _sensors(page: Page) -> Text:
    """The rate of each of their ports."""
    names = {name for name, stage in page["stages"].items() if _is_sensor(stage)}
    rates = [
        _rate(output, f"{_short(port)} ")
        for port, output in page["outputs"].items()
        if port.partition("/")[0] in names
    ]
    return Text("sensors, Hz: ").append(Text(", ").join(rates))


def _stages(page: Page, brief: bool) -> Table:
    columns = ("output Hz", "runs Hz", "CPU %", "queue", "most", "waiting", "lost/s", "lost", "")
    table = _table("stage", *columns)
    for name, stage in page["stages"].items():
        if brief and _is_sensor(stage):
            continue
        outputs = {
            port.partition("/")[2]: output
            for port, output in page["outputs"].items()
            if port.startswith(f"{name}/")
        }
        rates = Text("  ").join(
            _rate(output, "" if port == "out" else f"{port} ") for port, output in outputs.items()
        )
        losing = "yellow" if stage["lost_hz"] else "dim"
        table.add_row(
            name,
            rates,
            "" if _is_sensor(stage) else f"{stage['runs_hz']:.1f}",
            f"{100 * stage['cpu_cores']:.1f}",
            str(stage.get("queued", "")),
            str(stage.get("queued_peak", "")),
            str(stage.get("waiting") or ""),
            Text(f"{stage['lost_hz']:.1f}" if stage["lost_hz"] else "", losing),
            Text(str(stage["lost"] or ""), losing),
            _trouble(stage),
        )
    return table


def _rate(output: Page, prefix: str) -> Text:
    """The rate, or in red how long the next message is overdue."""
    rate, silent = output["rate_hz"], output["silent_s"]
    if not output["count"]:
        return Text(f"{prefix}-", "dim")
    overdue_s = max(OVERDUE_PERIODS / rate if rate else 0.0, OVERDUE_LEAST_S)
    if silent is not None and silent > overdue_s:
        return Text(f"{prefix}none for {silent:.1f} s", "red")
    return Text(f"{prefix}{rate:.1f}")


def _trouble(stage: Page) -> Text:
    words = [f"{stage['errors']} errors"] if stage["errors"] else []
    words += ["stopped"] if stage["stopped"] else []
    return Text(", ".join(words), "red")


def _ages(page: Page, brief: bool) -> list[RenderableType]:
    """Per output of a stage, the age of each sensor's sample in it when it was published; in brief
    of those that no stage with an output reads."""
    outputs = page["outputs"]
    made = {
        port: output["ages_ms"]
        for port, output in outputs.items()
        if output["ages_ms"].keys() - {port}
    }
    if brief:
        speaks = {port.partition("/")[0] for port in outputs}
        edges = (edge.partition("->") for edge in page["edges"])
        read = {port for port, _, entry in edges if entry.partition("/")[0] in speaks}
        made = {port: ages for port, ages in made.items() if port not in read}
    streams = list(dict.fromkeys(stream for ages in made.values() for stream in ages))
    if not streams:
        return []
    streams.sort(key=list(outputs).index)
    table = _table("age when published, ms", *(_short(stream) for stream in streams))
    for port, ages in made.items():
        cells = (f"{ages[stream]:.0f}" if stream in ages else "" for stream in streams)
        table.add_row(_short(port), *cells)
    return [table, Text()]


def _devices(devices: Mapping[str, Page], brief: bool) -> Table:
    """In brief without the stages that use them, which would take more lines."""
    table = _table(
        "device", "state", "busy %", "runs", "infers now", *([] if brief else ["stages"])
    )
    for column in table.columns[4:]:
        column.justify, column.no_wrap = "left", column is table.columns[4]
    for name, device in devices.items():
        table.add_row(
            name,
            Text("up", "green") if device["up"] else Text("lost", "red"),
            f"{100 * device['busy_fraction']:.1f}",
            str(device["runs"]),
            device["inferring"] or "",
            *([] if brief else [", ".join(device["stages"])]),
        )
    return table


def _event(event: Page) -> Text:
    first_line = event["text"].partition("\n")[0]
    line = Text(f"{event['at_s']:7.2f} s  {event['kind']} {event['of']}: {first_line}")
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", no_wrap=True)
    return table


def _short(port: str) -> str:
    return port.removesuffix("/out")


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f} %"


def _for(page: Page) -> str:
    seconds = int(time.time() - page["began"]) if "elapsed_s" not in page else page["elapsed_s"]
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds // 60:.0f} min {seconds % 60:.0f} s"
