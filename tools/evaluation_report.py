"""An evaluation for a person: IoU by class, and how sharp a map is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

HEADS = {"all": "IoU", "labeled": "where labeled", "in_view": "in camera view"}


def print_verdict(verdict: Mapping[str, Any], console: Console) -> None:
    """Print the tables of a verdict as `evaluate --json` gives it."""
    views = verdict["views"]
    if views:
        console.print(_agreement(views, verdict.get("frames", 1)))
        console.print(_facts(verdict), style="dim", highlight=False, soft_wrap=True)
    if "sharpness" in verdict:
        if views:
            console.print()
        console.print(_sharpness(verdict["sharpness"]))
        console.print(
            "Thickness: how far the voxels of a surface scatter across it. Disputed: an entropy as "
            "of 90 to 10 %, or more. Blobs: touching voxels, 10 or more.",
            style="dim",
            highlight=False,
        )


def _agreement(views: Mapping[str, Any], frames: int) -> Table:
    table = Table("class", box=None, pad_edge=False, header_style="bold")
    shown = [name for name in HEADS if name in views]
    for head in ("points", *(HEADS[name] for name in shown)):
        table.add_column(head, justify="right")
    if frames > 1:
        table.add_column("mean of frames", justify="right")
    every = views["all"]
    for name, row in every["classes"].items():
        cells = [_percent(views[view]["classes"].get(name, {}).get("iou")) for view in shown]
        if frames > 1:
            cells.append(_percent(row["iou_over_frames"]))
        style = None if row["in_mean"] else "dim"
        table.add_row(name, f"{row['points']:,}", *cells, style=style)
    means = [_percent(views[view]["mean_iou"]) for view in shown]
    if frames > 1:
        means.append(_percent(every["mean_iou_over_frames"]))
    table.add_section()
    table.add_row("mean", f"{every['points']:,}", *means, style="bold")
    return table


def _facts(verdict: Mapping[str, Any]) -> str:
    every = verdict["views"]["all"]
    facts = [f"{_percent(every['accuracy'])} of the points have their class."]
    if "frames" in verdict:
        facts.append(f"{verdict['frames']} frames, {verdict['points']:,} points")
    else:
        facts.append(f"{verdict['points']:,} annotated points")
    facts[-1] += f", {verdict['points_without_truth']:,} of them without truth (left out)."
    if verdict.get("truth_without_prediction"):
        facts.append(f"{verdict['truth_without_prediction']} true frames have no prediction.")
    if verdict.get("points_out_of_reach"):
        reach_m = verdict["radius_m"]
        where = "of theirs" if reach_m is None else f"within {reach_m:g} m"
        facts.append(f"{verdict['points_out_of_reach']:,} have no voxel {where} (misses).")
    rare = [name for name, row in every["classes"].items() if not row["in_mean"]]
    if rare:
        facts.append(f"Too few points for the mean: {', '.join(rare)}.")
    return " ".join(facts)


def _sharpness(measured: Mapping[str, Any]) -> Table:
    table = Table("map", box=None, pad_edge=False, header_style="bold")
    for head in ("voxels", "thickness", "disputed", "entropy", "blobs"):
        table.add_column(head, justify="right")
    for name, row in measured.items():
        table.add_row(
            name,
            f"{row['voxels']:,}",
            _number(row["thickness_m"], 3, " m"),
            _percent(row["disputed"]),
            _number(row["entropy"], 3, ""),
            str(row["blobs"]),
            style="bold" if name == "all" else None,
        )
    return table


def _percent(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{100 * value:.1f} %"


def _number(value: float, digits: int, unit: str) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}{unit}"
