"""`overflight evaluate-detections`: a detector of the registry against boxes that people drew."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from accelerators.registry import Registry
from pipeline.errors import ModelError
from pipeline.message import Message
from pipeline.model import Accelerator, BoundModel
from stages.detect import DetectObjects
from stages.kernels.average_precision import (
    FrameHits,
    average_precision,
    bootstrap_interval,
    match,
    recall_at,
)
from stages.kernels.render import draw_box, encode_png
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Detections, Image
from tools.annotated_flights import read_flight
from tools.annotated_images import AnnotatedImage, read_annotated
from tools.models.check import computing_devices

#: Average precision needs the weak detections too; a graph's stage starts at 0.4.
MIN_SCORE, MAX_BOXES = 0.02, 300
#: What recall and precision are told at: the score from which a graph's stage keeps a box.
WORKING_SCORE = 0.4
#: What is drawn around objects that were annotated, RGB.
TRUTH_COLOR = (255, 255, 255)


@dataclass(slots=True)
class Judged:
    """What a detector found in a set of images, by class, and what that cost."""

    hits: dict[str, list[FrameHits]]
    infer_ms: list[float] = field(default_factory=list)
    finish_ms: list[float] = field(default_factory=list)


def evaluate_detections(
    model: str,
    images: Path,
    *,
    registries: Sequence[Path],
    kind: str | None,
    min_iou: float,
    min_side_px: float,
    pictures: Path | None,
    as_json: bool,
) -> None:
    """Judge, print, and draw what was asked for. Raises OverflightError naming the place."""
    registry = Registry.open(*registries)
    bound, where = open_model(registry, model, kind)
    channels = bound.spec.input_shape[-1]
    annotated = [one.without_small(min_side_px) for one in read_any(images, channels)]
    console = Console(stderr=True)
    shown = track(annotated, "judging", console=console, disable=not console.is_terminal)
    judged = judge(bound, shown, min_iou=min_iou, pictures=pictures)
    verdict = {"model": model, "device": where, "images": len(annotated)}
    verdict |= {"min_iou": min_iou, "min_side_px": min_side_px}
    verdict |= summary(judged)
    if as_json:
        typer.echo(json.dumps(verdict, indent=2))
    else:
        _print(verdict, Console())


def read_any(images: Path, channels: int) -> list[AnnotatedImage]:
    """Annotated images of a folder, or those of flights with so many channels. Raises DataError."""
    if images.suffix == ".mcap" or any(images.glob("*.mcap")):
        return read_flight(images, channels)
    return read_annotated(images)


def open_model(registry: Registry, model: str, kind: str | None) -> tuple[BoundModel, str]:
    """The model on a device of this machine, by the kind of its file; and both in words."""
    known = [variant for variant in registry.entry(model).variants if variant.file is not None]
    variants = [variant for variant in known if kind in (None, variant.kind)]
    if not variants:
        kinds = ", ".join(variant.kind for variant in known) or "nothing but an emulation"
        raise ModelError(f"model '{model}' has no {kind or 'file'} to be judged; it has {kinds}")
    devices: list[Accelerator] = list(computing_devices())
    for variant in variants:
        for device in devices:
            if variant.kind in device.kinds:
                probe = device.probe()
                words = f"{variant.kind} on {probe.name}, {probe.runtime}"
                return registry.load(model, device, variant), words
    kinds = ", ".join(variant.kind for variant in variants)
    raise ModelError(f"model '{model}': nothing on this machine runs its files ({kinds})")


def judge(
    model: BoundModel,
    images: Iterable[AnnotatedImage],
    *,
    min_iou: float,
    pictures: Path | None = None,
) -> Judged:
    """Run the detector over annotated images as a graph would, one thread, and match its boxes."""
    stage = DetectObjects(min_score=MIN_SCORE, max_boxes=MAX_BOXES)
    stage.model = model.spec
    stage.open()
    taxonomy = load_taxonomy()
    names = dict.fromkeys(model.spec.head["class_map"].values())
    judged = Judged({name: [] for name in names})
    for image in images:
        pixels = image.read()
        message = Message.at(0, Image(pixels, "camera"))
        native = model.encode(stage.prepare(message))
        started = time.perf_counter()
        outputs = model.infer(native)
        inferred = time.perf_counter()
        found = stage.finish(model.decode(outputs), message)
        judged.infer_ms.append((inferred - started) * 1e3)
        judged.finish_ms.append((time.perf_counter() - inferred) * 1e3)
        for name in names:
            judged.hits[name].append(_match(found, image, taxonomy.id(name), min_iou))
        if pictures is not None:
            drawn = draw(pixels, found, image)
            with whole_file(pictures / f"{image.path.stem}.png") as file:
                file.write(encode_png(drawn))
    return judged


def _match(found: Detections, image: AnnotatedImage, label: int, min_iou: float) -> FrameHits:
    mine = found.classes == label
    return match(
        found.boxes[mine],
        found.scores[mine],
        image.boxes[image.classes == label],
        image.boxes[image.ignored],
        min_iou,
    )


def summary(judged: Judged) -> dict[str, Any]:
    """Figures of every class and the median cost, None where there is nothing to judge."""
    classes = {}
    for name, frames in judged.hits.items():
        low, high = bootstrap_interval(frames)
        recall, precision = recall_at(frames, WORKING_SCORE)
        classes[name] = {
            "objects": sum(frame.objects for frame in frames),
            "ap": _known(average_precision(frames)),
            "interval": [_known(low), _known(high)],
            "recall": _known(recall),
            "precision": _known(precision),
        }
    return {
        "classes": classes,
        "infer_ms": round(float(np.median(judged.infer_ms)), 2),
        "finish_ms": round(float(np.median(judged.finish_ms)), 2),
    }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)


def draw(pixels: NDArray[Any], found: Detections, image: AnnotatedImage) -> NDArray[np.uint8]:
    """The image with the boxes that a graph would keep, and in white those that people drew."""
    taxonomy = load_taxonomy()
    gray = pixels.ndim == 2
    canvas = np.ascontiguousarray(np.repeat(pixels[..., None], 3, axis=2) if gray else pixels)
    for box in image.boxes:
        draw_box(canvas, box, "", TRUTH_COLOR)
    for box, label, score in zip(found.boxes, found.classes, found.scores, strict=True):
        if score >= WORKING_SCORE:
            text = f"{taxonomy.names[label]} {score:.2f}"
            draw_box(canvas, box, text, taxonomy.colors[label])
    return canvas


def _print(verdict: Mapping[str, Any], console: Console) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("class")
    heads = (
        "objects",
        f"AP{round(100 * verdict['min_iou'])}",
        "90 % of draws",
        "recall",
        "precision",
    )
    for head in heads:
        table.add_column(head, justify="right")
    for name, row in verdict["classes"].items():
        low, high = row["interval"]
        span = "-" if low is None else f"{100 * low:.1f} to {100 * high:.1f}"
        cells = [_percent(row[key]) for key in ("ap", "recall", "precision")]
        table.add_row(name, str(row["objects"]), cells[0], span, *cells[1:])
    console.print(table)
    if verdict["min_side_px"] > 0:
        console.print(f"Boxes with a side below {verdict['min_side_px']:g} px are left out.")
    console.print(
        f"{verdict['images']} images; {verdict['device']}: {verdict['infer_ms']:.1f} ms a frame, "
        f"decoding {verdict['finish_ms']:.1f} ms (medians). Recall and precision at a score of "
        f"{WORKING_SCORE}.",
        style="dim",
        highlight=False,
        soft_wrap=True,
    )


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"
