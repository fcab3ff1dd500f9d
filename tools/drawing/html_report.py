"""A profile as one HTML page that needs nothing else: no network, no script, pictures inline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from tools.drawing.diagram import Diagram
from tools.drawing.plot import COLORS, Line, bar_plot, line_plot
from tools.drawing.svg import svg
from tools.profiling.profile_page import PARTS
from tools.profiling.profile_table import (
    EMULATED,
    EMULATED_NOTE,
    Column,
    both,
    name,
    number,
    sweep_columns,
    sweep_note,
    why_not_run,
)

#: Stages of less are left out of the bars, which say so.
LEAST_PERCENT = 0.05
REST = "the rest of the process"
#: Columns of words; the others are figures.
WORDS = ("stage", "device", "variant", "model", "not used")

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 ui-sans-serif, system-ui, "Segoe UI", Helvetica, Arial, sans-serif;
       color: #0f172a; background: #f1f5f9; margin: 0; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 26px; margin: 0 0 2px; } h2 { font-size: 18px; margin: 34px 0 10px; }
p { margin: 6px 0; } .dim { color: #64748b; font-size: 13px; }
.tiles { display: flex; flex-wrap: wrap; gap: 12px; margin-top: 18px; }
.tile { background: #fff; border-radius: 8px; padding: 10px 18px; border: 1px solid #e2e8f0; }
.tile b { display: block; font-size: 22px; }
.card { background: #fff; border: 1px solid #e2e8f0; border-radius: 8px; padding: 12px;
        overflow-x: auto; }
.card + .card { margin-top: 12px; }
.card svg { max-width: 100%; height: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px; }
th, td { padding: 3px 10px; text-align: right; white-space: nowrap; }
th { color: #64748b; font-weight: 600; border-bottom: 1px solid #e2e8f0; white-space: normal;
     vertical-align: bottom; }
th.words, td.words { text-align: left; }
td.words:last-child { white-space: normal; min-width: 190px; }
tr:nth-child(even) td { background: #f8fafc; } .warn { color: #b45309; }
"""


def html_page(
    page: Mapping[str, Any] | None,
    diagram: Diagram,
    sweep: Sequence[Mapping[str, Any]],
    machine: str,
    command: str,
) -> str:
    """The whole page: of one run, of a sweep, or of both."""
    body = [f"<h1>{escape(diagram.name)}</h1>", f'<p class="dim">{escape(machine)}</p>']
    body.append(f'<p class="dim"><code>{escape(command)}</code></p>')
    emulated = [row for row in (page["stages"] if page else sweep) if row["emulated"]]
    if emulated:
        body.append(
            f'<p class="warn">{EMULATED} marks what ran emulated: an emulated device takes the '
            "time that its file declares, and what a real one's driver costs the CPU is not in "
            "it. Such figures are no measurements of hardware.</p>"
        )
    if page:
        body += _run(page, diagram)
    if sweep:
        body += ["<h2>Sweep</h2>", f'<div class="card">{sweep_plot(sweep)}</div>', _points(sweep)]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(diagram.name)}: profile</title>"
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + "\n</main></body></html>\n"
    )


def sweep_plot(sweep: Sequence[Mapping[str, Any]]) -> str:
    """CPU over output rate, a line per variant and device, as Fig 9 of the paper."""
    ran = [point for point in sweep if not point["failed"] and point["rate_hz"] is not None]
    variants = list(dict.fromkeys(point["variant"] for point in ran))
    devices = list(dict.fromkeys(point["device"] for point in ran))
    lines = []
    for variant in variants:
        for device in devices:
            points = [p for p in ran if (p["variant"], p["device"]) == (variant, device)]
            if not points:
                continue
            mark = EMULATED if any(point["emulated"] for point in points) else ""
            lines.append(
                Line(
                    f"{mark}{variant}{f', {device}' if device else ''}",
                    sorted((point["rate_hz"], point["cpu_percent"]) for point in points),
                    variants.index(variant) % len(COLORS),
                    dashed=devices.index(device) > 0,
                )
            )
    note = EMULATED_NOTE if any(point["emulated"] for point in ran) else ""
    return line_plot(lines, "output rate, Hz", "CPU load, % of a core", note)


def _run(page: Mapping[str, Any], diagram: Diagram) -> list[str]:
    stages = page["stages"]
    loads = {row["stage"]: row["cpu_percent"] for row in stages}
    ages = [row for row in stages if row["age_ms"] and not row["source"]]
    oldest = max(ages, key=lambda row: row["age_ms"]["p99"], default=None)
    tiles = [
        (f"{page['process_percent']:.0f} %", "of a core, everything together"),
        (f"{sum(loads.values()):.0f} %", "of it in stages"),
        (f"{page['rest_percent']['unattributed']:.2f} %", "unattributed"),
    ]
    if oldest:
        tiles.append(
            (f"{oldest['age_ms']['p99']:.0f} ms", f"oldest output, p99 ({oldest['stage']})")
        )
    return [
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{big}</b>{escape(small)}</div>' for big, small in tiles)
        + "</div>",
        "<h2>The graph and its loads</h2>",
        f'<div class="card">{svg(diagram, loads)}</div>',
        '<p class="dim">Percent of a core in each box; a full bar is one core.</p>',
        "<h2>Where the CPU goes</h2>",
        f'<div class="card">{bar_plot(_bars(page), "CPU load, % of a core", (*PARTS, REST))}</div>',
        f'<p class="dim">{_left_out(page)}</p>',
        "<h2>Age of the outputs</h2>",
        f'<div class="card">{bar_plot(_ages(ages), "ms from the oldest sensor sample")}</div>',
        "<h2>Stages</h2>",
        _stages(stages),
    ]


def _bars(page: Mapping[str, Any]) -> list[tuple[str, dict[str, float]]]:
    """What each stage and the rest of the process took, a stage's by part."""
    rows = []
    for row in sorted(page["stages"], key=lambda row: -row["cpu_percent"]):
        if row["cpu_percent"] < LEAST_PERCENT:
            continue
        counts = {
            part: sum(
                device.get("infer" if part == "transfer" else part, {}).get("count", 0)
                for device in row["steps"].values()
            )
            for part in row["cpu_ms"]
        }
        load = {part: ms * counts[part] / page["wall_s"] / 10 for part, ms in row["cpu_ms"].items()}
        rows.append((name(row), {part: load[part] for part in PARTS if part in load}))
    rows += [(part, {REST: load}) for part, load in page["rest_percent"].items()]
    return rows


def _left_out(page: Mapping[str, Any]) -> str:
    """The stages without a bar, in words."""
    small = [name(row) for row in page["stages"] if row["cpu_percent"] < LEAST_PERCENT]
    without = f" Below {LEAST_PERCENT:g} %: {', '.join(small)}." if small else ""
    return escape(f"Bars of stages are split by the parts of a run.{without}")


def _ages(stages: Sequence[Mapping[str, Any]]) -> list[tuple[str, dict[str, float]]]:
    rows = []
    for row in stages:
        age = row["age_ms"]
        if age["p50"] is not None:
            more = {"up to the 99th percentile": age["p99"] - age["p50"]}
            rows.append((row["stage"], {"median": age["p50"], **more}))
    return rows


def _stages(stages: Sequence[Mapping[str, Any]]) -> str:
    parts = [part for part in PARTS if any(part in row["cpu_ms"] for row in stages)]
    head = ["stage", "device", "rate, Hz", "CPU, %", *(f"{part}, CPU ms" for part in parts)]
    head += ["ran, ms", "queued, ms", "device busy, %", "age, ms", "not used"]
    rows = [
        [
            name(row),
            ", ".join(row["devices"]),
            number(row["rate_hz"], 1),
            number(row["cpu_percent"], 1),
            *(number(row["cpu_ms"].get(part), 2) for part in parts),
            both(row["ran_ms"]),
            both(row["queued_ms"]),
            number(row["busy_percent"], 0),
            both(row["age_ms"]),
            ", ".join(f"{count} {reason}" for reason, count in row["dropped"].items()),
        ]
        for row in stages
    ]
    note = '<p class="dim">Two figures are p50/p99. CPU ms: mean of one step.</p>'
    return f'<div class="card">{_table(head, rows)}</div>{note}'


def _points(sweep: Sequence[Mapping[str, Any]]) -> str:
    ran = [point for point in sweep if not point["failed"]]
    words = (
        Column("variant", name),
        Column("model", lambda point: point["model"] or ""),
        Column("device", lambda point: point["device"]),
    )
    shown = [column for column in words if any(map(column.cell, ran))] + sweep_columns(ran)
    rows = [[column.cell(point) for column in shown] for point in ran]
    not_run = [f"Not run: {why_not_run(point)}." for point in sweep if point["failed"]]
    notes = [*not_run, sweep_note(ran)]
    return f'<div class="card">{_table([column.head for column in shown], rows)}</div>' + "".join(
        f'<p class="dim">{escape(note)}</p>' for note in notes
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        kinds = [' class="words"' if column in WORDS else "" for column in head]
        return "".join(
            f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True)
        )

    lines = [line(head, "th"), *(line(row, "td") for row in rows)]
    return "<table>" + "\n".join(f"<tr>{cells}</tr>" for cells in lines) + "</table>"
