"""The model card: what a network was trained on, how, and what it scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the weights come from."""

    command: str  #: that makes them again
    data: str  #: path and content in words
    license: str
    attribution: str  #: whom to name beside the weights
    steps: int
    seed: int
    minutes: float
    parameters: int
    loss: float


def model_card(
    name: str,
    description: str,
    architecture: str,
    origin: Origin,
    files: Sequence[Path],
    verdicts: Sequence[Mapping[str, Any]],
) -> str:
    """Markdown; `verdicts` are those of `overflight evaluate-detections`, one per file judged."""
    lines = [
        f"# {name}",
        "",
        f"{description}.",
        "",
        "| | |",
        "|---|---|",
        f"| network | {architecture}, {origin.parameters:,} parameters |",
        f"| trained on | {origin.data} |",
        f"| license | {origin.license} |",
        f"| to be named | {origin.attribution} |",
        f"| trained by | `{origin.command}` |",
        f"| steps, seed | {origin.steps:,}, {origin.seed} |",
        f"| time | {origin.minutes:.0f} min |",
        f"| loss at the end | {origin.loss:.3f} (curve.csv) |",
        "",
        "| file | MB |",
        "|---|---|",
        *(f"| {file.name} | {_megabytes(file):.2f} |" for file in files),
    ]
    for verdict in verdicts:
        lines += ["", *_scores(verdict)]
    return "\n".join(lines) + "\n"


def _megabytes(file: Path) -> float:
    """With the weights that lie beside an .xml."""
    weights = file.with_suffix(".bin")
    sizes = [one.stat().st_size for one in (file, weights) if one.suffix != ".bin"]
    if file.suffix == ".xml" and weights.is_file():
        sizes.append(weights.stat().st_size)
    return sum(sizes) / 1e6


def _scores(verdict: Mapping[str, Any]) -> list[str]:
    percent = round(100 * verdict["min_iou"])
    lines = [
        f"On {verdict['images']} images of {verdict['judged_on']}, {verdict['device']}, "
        f"{verdict['infer_ms']:.1f} ms a frame:",
        "",
        f"| class | objects | AP{percent} | 90 % of draws of the images | recall | precision |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in verdict["classes"].items():
        low, high = row["interval"]
        span = "-" if low is None else f"{100 * low:.1f} to {100 * high:.1f}"
        figures = [_percent(row[key]) for key in ("ap", "recall", "precision")]
        cells = [name, str(row["objects"]), figures[0], span, *figures[1:]]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"
