"""The tables of `overflight compare`: what each side cost, and how far they agree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from pipeline.graph.wording import numbered

#: Columns of the classes of a port: key of the row, heading, how it is shown.
LABEL_COLUMNS = (
    ("share_a", "in a", "percent"),
    ("share_b", "in b", "percent"),
    ("iou", "IoU", "number"),
)
BOX_COLUMNS = (
    ("count_a", "in a", "count"),
    ("count_b", "in b", "count"),
    ("matched", "matched", "count"),
    ("iou", "IoU", "number"),
    ("score_difference", "b - a", "signed"),
    ("largest_score_difference", "at most", "number"),
    ("best_only_a", "only a", "number"),
    ("best_only_b", "only b", "number"),
)


def print_comparison(page: Mapping[str, Any], console: Console) -> None:
    """Print the page as `overflight compare --json` writes it."""
    console.print(f"\n[bold]{page['graph']}[/bold]\n")
    for side in ("a", "b"):
        said = ", ".join(page[side]["settings"]) or "the file as it is"
        console.print(f"{side}: {said}", highlight=False, soft_wrap=True)
    console.print()
    console.print(_costs(page))
    console.print(
        "CPU: mean per run, of the stage's own threads. Device: time that infer takes; far above "
        "its CPU on a CPU, the machine was busy. Latency: prepare, device, finish; no waiting.\n",
        style="dim",
    )
    for port, found in page["agreement"].items():
        name = port.removesuffix("/out")
        console.print(f"[bold]{name}[/bold]: {_sentence(found)}", highlight=False, soft_wrap=True)
        if found["classes"]:
            console.print(_classes(found))
        console.print()
    if any(found["places"] == "boxes" for found in page["agreement"].values()):
        console.print(
            "b - a, at most: difference of scores, mean and largest. only a, only b: best score "
            "of a box without a counterpart.",
            style="dim",
        )
    if page["not_compared"]:
        names = ", ".join(page["not_compared"])
        console.print(f"Not compared, of payloads without a measure: {names}", highlight=False)


def _costs(page: Mapping[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("stage", "", "device"):
        table.add_column(heading, overflow="fold")
    for heading in ("CPU", "of it infer", "device p50", "p99", "latency"):
        table.add_column(heading, justify="right")
    for stage in page["a"]["stages"]:
        costs = [page[side]["stages"][stage] for side in ("a", "b")]
        same_model = len({cost.get("model") for cost in costs}) == 1
        for side, cost in zip(("a", "b"), costs, strict=True):
            times = cost.get("device_ms", {})
            device = cost.get("device", "")
            table.add_row(
                stage if side == "a" else "",
                side,
                device if same_model else f"{device}, {cost.get('model')}",
                _ms(sum(cost["cpu_ms"].values())),
                _ms(cost["cpu_ms"].get("infer")),
                _ms(times.get("p50")),
                _ms(times.get("p99")),
                _ms(cost.get("latency_ms")),
            )
    return table


def _sentence(found: Mapping[str, Any]) -> str:
    said = f"{numbered(found['messages'], 'message')} of each"
    for side in ("a", "b"):
        if alone := found[f"messages_only_{side}"]:
            said += f", {alone} only in {side}"
    if found["places"] == "boxes":
        said += f"; {found['count_a']} boxes in a, {found['count_b']} in b"
        said += f", {found['matched']} matched"
        if found["matched"]:
            said += (
                f" at IoU {found['mean_iou']:.3f}, scores b - a {found['score_difference']:+.4f} "
                f"in the mean, {found['largest_score_difference']:.3f} at most"
            )
        return said
    if held := found.get("held"):
        said += f"; {held['both']:,} voxels in both, {held['only_a']:,} only in a, "
        said += f"{held['only_b']:,} only in b"
    if seen := found.get("evidence"):
        said += f"; evidence in both for {seen['both']:,} points, only in a for "
        said += f"{seen['only_a']:,}, only in b for {seen['only_b']:,}"
    if not found["count"]:
        return said + "; nothing that both label"
    said += f"; same label on {100 * found['same_label']:.2f} % of {found['count']:,} "
    said += f"{found['places']}, mIoU {_or_dash(found['mean_iou'])}, "
    return said + f"confidence {found['confidence_difference']:.4f} apart in the mean"


def _classes(found: Mapping[str, Any]) -> Table:
    columns = BOX_COLUMNS if found["places"] == "boxes" else LABEL_COLUMNS
    table = Table("class", box=None, pad_edge=False, header_style="bold")
    for _, heading, _ in columns:
        table.add_column(heading, justify="right")
    for row in found["classes"]:
        table.add_row(row["class"], *(_shown(row[key], form) for key, _, form in columns))
    return table


def _shown(value: float | None, form: str) -> str:
    if value is None:
        return "-"
    if form == "percent":
        return f"{100 * value:.2f} %"
    if form == "signed":
        return f"{value:+.4f}"
    return str(value) if form == "count" else f"{value:.3f}"


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} ms"
