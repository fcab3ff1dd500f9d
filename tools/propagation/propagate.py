"""`overflight propagate`: a recording to scans with labels, and a report with pictures."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from stages.kernels.render import encode_png
from stages.observed import Observation
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from tools.propagation.observing import Order, observe
from tools.propagation.pictures import range_panels
from tools.propagation.report import write_page
from tools.propagation.sequence import SequenceWriter
from tools.propagation.settings import Settings, Teacher
from tools.propagation.survey import survey
from tools.propagation.teaching import Map, build_map, label_scans

REPORT, PAGE, PANELS = "report.json", "report.html", "panels"


@dataclass(frozen=True, slots=True)
class Product:
    """What the labels shall look like."""

    output: Path
    label_set: str | None = "semantickitti"
    scans: bool = True  #: write the scans too: a whole sequence
    pictures: int = 4
    surveyed: bool = True  #: measure what the other teachers would have labeled
    observed: Path | None = None  #: where the observations are, or shall be; None: in `output`


def propagate(
    order: Order, settings: Settings, product: Product, console: Console
) -> dict[str, Any]:
    """Observe, build the map, label, report. Raises OverflightError."""
    files, cached = observe(order, product.observed or product.output, console)
    report: dict[str, Any] = {
        "recording": str(order.recording),
        "graph": str(order.graph),
        "settings": asdict(settings),
        "scans": len(files),
        "observed_before": cached,
    }
    with _progress(console) as bar:
        wall, cpu = time.monotonic(), time.process_time()
        built: Map | None = None
        if settings.teacher is not Teacher.OVERLAY:
            with_map = bar.add_task("building the map", total=len(files))
            built = build_map(files, settings, lambda: bar.advance(with_map))
            report |= _facts(built)
        counts, labeled, degraded = _label(files, settings, built, product, bar)
        spent = {"wall_s": time.monotonic() - wall, "cpu_s": time.process_time() - cpu}
        report |= {
            "labeled_scans": labeled,
            "scans_left_out_degraded": len(files) - labeled if settings.sound_only else 0,
            "scans_degraded": degraded,
            "labels": counts,
            "propagation": spent
            | {f"scans_per_{name}": len(files) / max(value, 1e-9) for name, value in spent.items()},
        }
        if product.surveyed:
            own = built if settings.teacher is Teacher.CAMERA_MAP else None
            report |= _survey(files, settings, own, order.recording, product, bar)
    with whole_file(product.output / REPORT) as file:
        file.write((json.dumps(plain(report), indent=2) + "\n").encode())
    write_page(report, product.output / PAGE)
    return report


def plain(value: Any) -> Any:
    """The same for JSON, which knows no NaN and no enumerations."""
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _label(
    files: Sequence[Path],
    settings: Settings,
    built: Map | None,
    product: Product,
    bar: Progress,
) -> tuple[dict[str, Any], int, int]:
    """Write all labels: counts by class, scans labeled, and how many of them were degraded."""
    names = load_taxonomy().names
    by_class = np.zeros(len(names), dtype=np.int64)
    returns = labeled = degraded = 0
    task = bar.add_task("labeling scans", total=len(files))
    with SequenceWriter(product.output, product.label_set, scans=product.scans) as writer:
        for one in label_scans(files, settings, built):
            writer.write(one.observation, one.labels)
            by_class += np.bincount(one.labels[one.returns], minlength=len(names))
            returns += int(np.count_nonzero(one.returns))
            labeled += 1
            degraded += int(one.observation.degraded)
            bar.update(task, completed=labeled)
    given = {name: int(by_class[k]) for k, name in enumerate(names) if k and by_class[k]}
    share = sum(given.values()) / max(returns, 1)
    return {"returns": returns, "labeled_share": share, "classes": given}, labeled, degraded


def _facts(built: Map) -> dict[str, Any]:
    return {
        "voxels": len(built.index.labels),
        "voxels_labeled": int(np.count_nonzero(built.index.labels)),
        "voxels_mended_at_the_ground": built.smeared,
        "scans_in_map": built.scans,
    }


def _survey(
    files: Sequence[Path],
    settings: Settings,
    camera_map: Map | None,
    recording: Path,
    product: Product,
    bar: Progress,
) -> dict[str, Any]:
    """Who labels how much, and panels of some scans."""
    task = bar.add_task("comparing who labels what", total=len(files))
    chosen = {int(k) for k in np.linspace(0, len(files) - 1, product.pictures + 2)[1:-1].round()}
    names: list[str] = []

    def show(
        number: int,
        observation: Observation,
        labelings: Mapping[str, NDArray[np.uint8] | None],
    ) -> None:
        if number not in chosen:
            return
        names.append(f"{PANELS}/{number:06d}.png")
        with whole_file(product.output / names[-1]) as file:
            file.write(encode_png(range_panels(observation, labelings)))

    shares = survey(files, settings, camera_map, recording, show, lambda: bar.advance(task))
    return {"teachers": shares, "panels": names}


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
