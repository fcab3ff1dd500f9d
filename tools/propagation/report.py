"""What a propagation did, for a terminal and as a page with its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from stages.sinks.whole_file import whole_file
from tools.propagation.settings import Teacher

CAPTIONS = {
    Teacher.OVERLAY.value: "own images",
    Teacher.CAMERA_MAP.value: "camera map",
    Teacher.FUSED_MAP.value: "fused map",
}
STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .8em;text-align:right;"
    "border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)


def print_report(report: Mapping[str, Any], console: Console) -> None:
    """The shares and where everything lies."""
    table = Table(box=None)
    (column, *more), *rows = _rows(report)
    table.add_column(column, no_wrap=True)
    for name in more:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    if "teachers" in report:
        judged = "; how much of it is right, IoU by class" if "right" in more else ""
        console.print(f"who labels which share of the returns{judged}", soft_wrap=True)
        console.print(table)
    console.print(_sentence(report), highlight=False, soft_wrap=True)


def write_page(report: Mapping[str, Any], path: Path) -> None:
    """An HTML page beside the panels that it shows."""
    parts = [
        "<!doctype html><meta charset=utf-8><title>Label propagation</title>",
        f"<style>{STYLE}</style><h1>Label propagation</h1>",
        f"<p>{escape(str(report['recording']))}</p><p>{escape(_sentence(report))}</p>",
    ]
    if "teachers" in report:
        head, *rows = _rows(report)
        parts.append("<h2>Who labels how much</h2><table><tr>")
        parts += [f"<th>{escape(cell)}</th>" for cell in head]
        for row in rows:
            parts.append("</tr><tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row))
        parts.append("</tr></table>")
    for name in report.get("panels", ()):
        parts.append(f"<h3>scan {escape(Path(name).stem)}</h3><img src='{escape(name)}' alt=''>")
    parts.append("<h2>Settings</h2><table>")
    for name, value in report["settings"].items():
        parts.append(f"<tr><td>{escape(str(name))}</td><td>{escape(str(value))}</td></tr>")
    parts.append("</table>")
    with whole_file(path) as file:
        file.write("".join(parts).encode())


def _rows(report: Mapping[str, Any]) -> list[list[str]]:
    """The heading and a row per teacher."""
    teachers = report.get("teachers", {})
    judged = any("right_share" in told for told in teachers.values())
    rows = [["labeled by", "share", *(["right", *_groups(teachers)] * judged)]]
    for name, told in teachers.items():
        row = [CAPTIONS.get(name, name), f"{100 * told['labeled_share']:.1f} %"]
        if judged:
            row.append(f"{100 * told.get('right_share', float('nan')):.1f} %")
            iou = told.get("iou_of_labeled", {})
            row += [f"{100 * iou[g]:.0f}" if g in iou else "-" for g in _groups(teachers)]
        rows.append(row)
    return rows


def _groups(teachers: Mapping[str, Any]) -> list[str]:
    found: dict[str, None] = {}
    for told in teachers.values():
        found |= dict.fromkeys(told.get("iou_of_labeled", {}))
    return list(found)


def _sentence(report: Mapping[str, Any]) -> str:
    labels, spent = report["labels"], report["propagation"]
    told = (
        f"{report['labeled_scans']} of {report['scans']} scans labeled, "
        f"{100 * labels['labeled_share']:.1f} % of their {labels['returns']:,} returns"
    )
    if "voxels" in report:
        told += (
            f"; a map of {report['voxels']:,} voxels, {report['voxels_labeled']:,} of them sure, "
            f"{report['voxels_mended_at_the_ground']:,} mended at the ground"
        )
    if report["scans_degraded"]:
        told += f"; {report['scans_degraded']} scans were made while a device was degraded"
    if report["scans_left_out_degraded"]:
        told += f"; {report['scans_left_out_degraded']} such scans left out"
    return (
        f"{told}. Map and look-up: {spent['scans_per_wall_s']:.0f} scans/s "
        f"({spent['scans_per_cpu_s']:.0f} per CPU second)."
    )
