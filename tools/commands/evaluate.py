"""The words of `overflight evaluate`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson
from tools.tables.names import PaperFigure, PaperTable


@app.command(
    epilog=examples(
        "overflight evaluate out/labels --truth sequences/00 --truth-labels semantickitti",
        "overflight evaluate out/map.ply --truth annotated.ply --groups paper",
        "overflight evaluate out/map.ply",
        "overflight evaluate --table 5 --quick",
    )
)
def evaluate(
    prediction: Annotated[
        Path | None,
        typer.Argument(
            metavar="PREDICTION",
            help="A folder of label files, masks or npz, one per frame; or a map (PLY, npz, "
            "checkpoint).",
            show_default=False,
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="The same with true labels, or a simulated flight for a map. A map alone is "
            "measured for sharpness.",
            show_default=False,
        ),
    ] = None,
    labels: Annotated[
        str, typer.Option(metavar="SET", help="The label set of the prediction's ids.")
    ] = "overflight",
    truth_labels: Annotated[
        str, typer.Option(metavar="SET", help="The label set of the truth's ids.")
    ] = "overflight",
    ignore: Annotated[
        list[int] | None,
        typer.Option(
            metavar="ID", help="An id that counts as unlabeled. Repeatable.", show_default=False
        ),
    ] = None,
    groups: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Judge groups of classes: paper, paper_wide, or a YAML file of them.",
            show_default="each class",
        ),
    ] = None,
    min_points: Annotated[
        float,
        typer.Option(
            metavar="N",
            help="A class enters the mean with N points, or below 1: with that share of them.",
        ),
    ] = 0.001,
    rate_hz: Annotated[
        float, typer.Option(metavar="HZ", min=0.001, help="Frames per second, to number stamps by.")
    ] = 10.0,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Judge apart what the cameras see: the drive with points and calibration.",
            show_default=False,
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A YAML file with the calibration block, where the recording has none.",
            show_default=False,
        ),
    ] = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this camera. Repeatable.", show_default="all"),
    ] = None,
    radius_m: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            min=0.0,
            help="How far the voxel of an annotated point may be.",
            show_default="a voxel; 0 where the truth has voxels of the same size",
        ),
    ] = None,
    voxel_m: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            min=0.0,
            help="The map's voxels, where the file does not say.",
            show_default=False,
        ),
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the confusion matrix.", show_default=False),
    ] = None,
    table: Annotated[
        PaperTable | None,
        typer.Option(
            help="Make a table of the paper anew, in place of judging a PREDICTION: simulates, "
            "trains, judges; stopped, it goes on.",
            show_default=False,
        ),
    ] = None,
    figure: Annotated[
        PaperFigure | None,
        typer.Option(
            help="Draw a figure of the paper in the world of the tables: a street seen from above "
            "(5), what moves in it (6), persons whom no camera sees (12), four maps (13), without "
            "what moves (14), in another city (15), a long flight (16), a disaster site (17), "
            "daylight recall over distance (18).",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Of a --table: flights, networks, rows.")
    ] = Path("out/tables"),
    seeds: Annotated[
        int, typer.Option(metavar="N", min=1, help="Of a --table: trainings of each row.")
    ] = 3,
    steps: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Of a --table: of each training.", show_default="the scale's"
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="A --table in small: it shows that it works, not how well."),
    ] = False,
    shared: Annotated[
        Path,
        typer.Option(metavar="FOLDER", help="Of --table real: recordings and public networks."),
    ] = Path("../shared"),
    threads: Annotated[int, typer.Option(metavar="N", min=1, help="Of torch, in a --table.")] = 1,
    jobs: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Of a simulated --table: networks trained at once, each with up to 3 GB.",
            show_default="one per core, at most 4",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Judge labels, masks or a map against the truth: IoU by class, and a map's sharpness."""
    if table is not None or figure is not None:
        from tools.tables.order import TableOrder
        from tools.tables.run import run_figure, run_table

        if prediction is not None or (table is not None and figure is not None):
            raise typer.BadParameter("a --table judges no PREDICTION; ask for one thing at a time")
        jobs = jobs or max(1, min((os.cpu_count() or 1) // threads, 4))
        order = TableOrder(out, seeds, steps, quick, shared, threads, jobs)
        if table is not None:
            run_table(table, order, as_json=as_json)
        elif figure is not None:
            run_figure(figure, order)
        return
    if prediction is None:
        raise typer.BadParameter("give a PREDICTION to be judged, or a --table to be made")
    from stages.labeled_files import LabelSet
    from tools.evaluate import evaluate_path
    from tools.evaluation_frames import CameraView

    ignored = tuple(ignore or ())
    evaluate_path(
        prediction,
        truth,
        labels=LabelSet.named(labels, ignored),
        truth_labels=LabelSet.named(truth_labels, ignored),
        groups=groups,
        min_points=min_points,
        rate_hz=rate_hz,
        view=CameraView.open(recording, calibration, camera or (), rate_hz),
        radius_m=radius_m,
        voxel_m=voxel_m,
        as_json=as_json,
        png=png,
    )
