"""The options of `overflight train`, most of them of several of its commands."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class BackboneName(StrEnum):
    """What looks at the picture."""

    RESIDUAL = "residual"
    MOBILEDET = "mobiledet"


class SegmenterName(StrEnum):
    """What segments color images."""

    PYRAMID = "pyramid"
    DEEPLAB = "deeplab"


class HeadName(StrEnum):
    """What says where objects are."""

    CENTERNET = "centernet"
    SSD = "ssd"


Data = Annotated[
    Path,
    typer.Option(
        "--data",
        metavar="PATH",
        help="A folder of images with COCO annotations, or a simulated flight (.mcap).",
        show_default=False,
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        metavar="FOLDER",
        help="Checkpoint, curve, model files, registry, card. A training that was stopped goes on.",
    ),
]
Steps = Annotated[int, typer.Option(metavar="N", min=1, help="How long: batches to learn from.")]
Seed = Annotated[int, typer.Option(metavar="N", min=0, help="Another start, other crops.")]
Threads = Annotated[int, typer.Option(metavar="N", min=1, help="Of torch.")]
Backbone = Annotated[
    BackboneName, typer.Option(help="residual learns faster; mobiledet is the paper's.")
]
Head = Annotated[
    HeadName,
    typer.Option(help="ssd (the paper's) finds more in color, centernet in thermal images."),
]
License = Annotated[str, typer.Option(metavar="TEXT", help="Of the data, and so of the weights.")]
Attribution = Annotated[str, typer.Option(metavar="TEXT", help="Whom to name beside the weights.")]
JudgedOn = Annotated[
    Path | None,
    typer.Option(
        "--judge",
        metavar="FOLDER",
        help="Annotated images, of none of the scenes trained on: their scores go into the card.",
        show_default=False,
    ),
]
Restart = Annotated[bool, typer.Option("--restart", help="Forget the folder's checkpoint.")]
AsItIs = Annotated[
    bool,
    typer.Option(
        "--as-it-is", help="Do not go on: write the files of what a stopped training has learned."
    ),
]
Start = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="FOLDER|FILE|NAME",
        help="Begin with the weights of a training (its folder or .xml) or of a network that ships "
        "(detect-rgb): the same network, or the backbone and pyramid of another.",
        show_default="with none",
    ),
]
Zoom = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LEAST MOST",
        help="How much larger objects will be seen than in the data: lower flights, above 1.",
        show_default="the network's own",
    ),
]
Flight = Annotated[
    Path,
    typer.Option(
        "--data", metavar="FILE", help="A flight of 'overflight simulate'.", show_default=False
    ),
]
ScanData = Annotated[
    Path,
    typer.Option(
        "--data",
        metavar="PATH",
        help="A flight, a folder of labeled scans, or a mixture (.yaml).",
        show_default=False,
    ),
]
Width = Annotated[
    float, typer.Option(metavar="X", min=0.1, max=2.0, help="All channels times this.")
]
