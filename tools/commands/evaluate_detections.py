"""The words of `overflight evaluate-detections`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson, ModelFiles


@app.command(
    name="evaluate-detections",
    epilog=examples(
        "overflight evaluate-detections detect-thermal --images annotated/ --pictures out/boxes"
    ),
)
def judge_detections(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="A model of the registry.", show_default=False)
    ],
    images: Annotated[
        Path,
        typer.Option(
            metavar="PATH",
            help="A folder of images with COCO annotations (ann.json), or a simulated flight.",
            show_default=False,
        ),
    ],
    kind: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="Which of its files: tflite, openvino, onnx.",
            show_default="its first",
        ),
    ] = None,
    min_iou: Annotated[
        float, typer.Option(metavar="IOU", min=0.05, max=0.95, help="What counts as found.")
    ] = 0.5,
    min_side_px: Annotated[
        float,
        typer.Option(
            metavar="PX", min=0.0, help="Boxes with a shorter side count neither way, found or not."
        ),
    ] = 0.0,
    pictures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Draw every image with its boxes.", show_default=False),
    ] = None,
    models: ModelFiles = None,
    as_json: AsJson = False,
) -> None:
    """Judge a detector by drawn or true boxes: average precision, recall, cost of a frame."""
    from tools.evaluate_detections import evaluate_detections

    evaluate_detections(
        model,
        images,
        registries=models or (),
        kind=kind,
        min_iou=min_iou,
        min_side_px=min_side_px,
        pictures=pictures,
        as_json=as_json,
    )
