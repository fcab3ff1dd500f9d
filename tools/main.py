"""The command `overflight`: reads the words, hands the work on, and gives the exit code.

Everything heavy is imported inside the command that needs it, so that `--help` answers at once.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import DeviceError, GraphError, OverflightError, StageError
from tools.models import app as models_app
from tools.train.commands import app as train_app

PACKAGES = ("pipeline", "accelerators", "stages", "graphs", "tools")

RUN_FAILED = 1
USER_MISTAKE = 2

app = typer.Typer(
    name="overflight",
    epilog="Exit codes: 0 well, 1 a run failed, 2 a mistake in the file or the words.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(models_app, name="models")
app.add_typer(train_app, name="train")


class Drawing(StrEnum):
    """The forms that `overflight graph` draws in."""

    MERMAID = "mermaid"
    DOT = "dot"
    SVG = "svg"


GraphFile = Annotated[
    Path, typer.Argument(metavar="GRAPH", help="The graph file.", show_default=False)
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set one value of the file, e.g. parameters.voxel_m=0.1. Paths in it are relative "
        "to the working folder. Repeatable.",
        show_default=False,
    ),
]
Overlays = Annotated[
    list[Path] | None,
    typer.Option(
        "--overlay",
        metavar="FILE",
        help="Merge this file over the graph file. Repeatable; the last one wins.",
        show_default=False,
    ),
]
ModelFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--models",
        metavar="FILE",
        help="A further model registry beside the shipped one. Repeatable.",
        show_default=False,
    ),
]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder that $out stands for.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def parse_speed(text: str) -> float | None:
    """A factor of real time, or None for "max": as fast as the machine can, offline."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise typer.BadParameter(f"'{text}' is neither a number above 0 nor 'max'")
    return speed


@app.command(
    epilog="Example: overflight run graphs/drive.yaml --set parameters.recording=my_drive "
    "--speed max --out out/ --report out/report.json"
)
def run(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    speed: Annotated[
        str,
        typer.Option(
            metavar="FACTOR",
            help="1: real time. 2: twice as fast. max: offline, nothing is dropped and every run "
            "gives the same result.",
        ),
    ] = "1",
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Stop after so much time of the graph's clock. Ctrl-C stops earlier.",
            show_default="until the sources end",
        ),
    ] = None,
    out: Out = Path("out"),
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write rates, ages and losses as JSON.", show_default=False
        ),
    ] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write every run, wait, loss and decision as a Chrome trace, to look at in "
            "ui.perfetto.dev; FILE.gz is compressed.",
            show_default=False,
        ),
    ] = None,
    trace_entries: Annotated[
        int,
        typer.Option(
            metavar="COUNT", min=1, help="Keep so many entries of the trace, the last ones."
        ),
    ] = 200_000,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the report as JSON instead of a table.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress and no table; errors only.")
    ] = False,
) -> None:
    """Run a graph until its sources end, --duration is over, or Ctrl-C."""
    factor = parse_speed(speed)
    from tools.run import run_file

    failures = run_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        speed=factor,
        duration_s=duration,
        out=out,
        report=report,
        trace=trace,
        trace_entries=trace_entries,
        as_json=as_json,
        quiet=quiet,
    )
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)


@app.command(
    epilog="Examples: overflight top. overflight top uav. overflight top 4711 --once --json"
)
def top(
    which: Annotated[
        str | None,
        typer.Argument(
            metavar="[GRAPH|PROCESS]",
            help="The name of a graph that runs, or its process id.",
            show_default="the one that runs",
        ),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Print how it stands now, and leave.")
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print JSON: a line twice a second, with --once one page."),
    ] = False,
) -> None:
    """Watch a graph that runs in another shell: rates, CPU, queues, losses, ages, devices."""
    from tools.top import watch

    watch(which, once=once, as_json=as_json)


@app.command(
    epilog="Examples: overflight check graphs/drive.yaml --on my_drive --overlay limits.yaml. "
    "overflight check uav.yaml --on flight=field.mcap --duration 60 --json"
)
def check(
    graph: GraphFile,
    on: Annotated[
        list[str] | None,
        typer.Option(
            "--on",
            metavar="RECORDING",
            help="What to run it on: the value of the file's parameter `recording`, or NAME=VALUE "
            "for a parameter of another name. Repeatable.",
            show_default="as the file says",
        ),
    ] = None,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    speed: Annotated[
        str,
        typer.Option(metavar="FACTOR", help="As of run; max judges losses alone, not times."),
    ] = "1",
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Run so long.", show_default="until the sources end"
        ),
    ] = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Run a graph and check it against its `expect` block. Exit code 1: something was not met."""
    factor = parse_speed(speed)
    from tools.check import check_file

    well = check_file(
        graph,
        on=on or (),
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        speed=factor,
        duration_s=duration,
        out=out,
        as_json=as_json,
    )
    if not well:
        raise typer.Exit(RUN_FAILED)


@app.command(epilog="Example: overflight validate graphs/drive.yaml --overlay at_home.yaml")
def validate(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Find every mistake in a graph file without running it."""
    from tools.validate import validate_file

    valid = validate_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        out=out,
        as_json=as_json,
    )
    if not valid:
        raise typer.Exit(USER_MISTAKE)


@app.command(
    epilog="Examples: overflight evaluate out/labels --truth sequences/00 --truth-labels "
    "semantickitti. overflight evaluate out/map.ply --truth annotated.ply --groups paper. "
    "overflight evaluate out/map.ply (how sharp it is)."
)
def evaluate(
    prediction: Annotated[
        Path,
        typer.Argument(
            metavar="PREDICTION",
            help="A folder of label files, masks or npz, one per frame; or a map (PLY, npz, "
            "checkpoint).",
            show_default=False,
        ),
    ],
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
    as_json: AsJson = False,
) -> None:
    """Judge labels, masks or a map against the truth: IoU by class, and a map's sharpness."""
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


@app.command(
    name="evaluate-detections",
    epilog="Example: overflight evaluate-detections detect-thermal --images annotated/ --pictures "
    "out/boxes",
)
def judge_detections(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="A model of the registry.", show_default=False)
    ],
    images: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER", help="Images with COCO annotations (ann.json).", show_default=False
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
    pictures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Draw every image with its boxes.", show_default=False),
    ] = None,
    models: ModelFiles = None,
    as_json: AsJson = False,
) -> None:
    """Judge a detector by boxes that people drew: average precision, recall, cost of a frame."""
    from tools.evaluate_detections import evaluate_detections

    evaluate_detections(
        model,
        images,
        registries=models or (),
        kind=kind,
        min_iou=min_iou,
        pictures=pictures,
        as_json=as_json,
    )


@app.command(
    epilog="Examples: overflight statistics drives/06. overflight statistics street.pcap --adapt "
    "semantickitti --name os0_on_network -o scan_statistics.yaml. overflight statistics flight.osf "
    "--set remission=signal --scans 100 --json."
)
def statistics(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="A drive of the KITTI family (a folder) or an Ouster file (.pcap, .osf, .bag).",
            show_default=False,
        ),
    ],
    source: Annotated[
        str | None,
        typer.Option(
            metavar="CLASS",
            help="The source that reads it: module:Class with an option `path`.",
            show_default="by the recording",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Set one option of the source. Repeatable.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What the entry is called: the `sensor` of segment_scan.",
            show_default="the recording's name",
        ),
    ] = None,
    adapt: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Fit a network trained with this entry to the recording's sensor: z and remission "
            "are the recording's, range, x and y stay the network's.",
            show_default=False,
        ),
    ] = None,
    rows: Annotated[
        int, typer.Option(metavar="N", min=1, help="Rows of the network's image.")
    ] = 64,
    columns: Annotated[
        int, typer.Option(metavar="N", min=1, help="Columns of the network's image.")
    ] = 512,
    elevation: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOWEST HIGHEST",
            help="The field of view of the image in degrees.",
            show_default="that of the first scan",
        ),
    ] = None,
    scans: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Only the first N scans.", show_default="all"),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write the entry to a YAML file: the `statistics` of segment_scan. Its other "
            "entries stay.",
            show_default="only print",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure what a LiDAR network's input is normalized with; adapt a network to a sensor."""
    from tools.statistics import statistics_of

    statistics_of(
        recording,
        source=source,
        settings=settings or (),
        name=name,
        adapt=adapt,
        size=(rows, columns),
        elevation_deg=elevation,
        scans=scans,
        output=output,
        as_json=as_json,
    )


@app.command(
    epilog="Examples: overflight compare graphs/drive.yaml --b devices.ov.precision=bf16. "
    "overflight compare graph.yaml --a stages.segment_rgb.executor=cpu "
    "--b stages.segment_rgb.executor=igpu --report swap.json"
)
def compare(
    graph: GraphFile,
    a: Annotated[
        list[str] | None,
        typer.Option(
            "--a",
            metavar="KEY=VALUE",
            help="What one side sets, as --set does. Repeatable.",
            show_default="the file as it is",
        ),
    ] = None,
    b: Annotated[
        list[str] | None,
        typer.Option(
            "--b", metavar="KEY=VALUE", help="What the other side sets.", show_default=False
        ),
    ] = None,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Compare so much of the recording. Ctrl-C stops without a result.",
            show_default="all of it",
        ),
    ] = None,
    out: Out = Path("out"),
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write agreement and cost as JSON.", show_default=False),
    ] = None,
    as_json: AsJson = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="No progress and no tables; errors only.")
    ] = False,
) -> None:
    """Run one recording through two settings of a graph: do they agree, and what does each cost?

    Compares every stage that differs and all that follow; sinks write to a/ and b/ of --out.
    """
    from tools.compare import compare_file

    failures = compare_file(
        graph,
        settings=settings or (),
        a=a or (),
        b=b or (),
        overlays=overlays or (),
        models=models or (),
        duration_s=duration,
        out=out,
        report=report,
        as_json=as_json,
        quiet=quiet,
    )
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)


@app.command(
    epilog="Examples: overflight profile graphs/emulated_uav.yaml --html profile.html. "
    "overflight profile graphs/drive.yaml --sweep executor --sweep rate_hz=1,2,5,10,15 "
    "--plot load.svg. overflight profile graph.yaml --sweep executor --save-costs costs.yaml"
)
def profile(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WHAT",
            help="executor: each model alone on every device that can run it. rate_hz=1,2,5: at "
            "these input rates. overlay=a.yaml,b.yaml: the graph under each file. Repeatable.",
            show_default=False,
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=1.0,
            help="Of the run, or of every run of a sweep. Ctrl-C stops earlier.",
            show_default="20, in a sweep 5",
        ),
    ] = None,
    out: Out = Path("out"),
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write one page with tables and plots.", show_default=False
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw a sweep's CPU load over rate as SVG.", show_default=False
        ),
    ] = None,
    save_costs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write what every step cost, for 'plan'.", show_default=False
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure what every stage costs in real time: CPU by part, waits, device time, age, losses."""
    from tools.profile import profile_file

    failures = profile_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        sweep=sweep or (),
        duration_s=duration,
        out=out,
        html=html,
        plot=plot,
        costs=save_costs,
        as_json=as_json,
    )
    for failure in failures:
        complain(failure)
    if failures:
        raise typer.Exit(RUN_FAILED)


@app.command(
    epilog="Examples: overflight profile graphs/emulated_uav.yaml --save-costs costs.yaml, then "
    "overflight plan graphs/emulated_uav.yaml --costs costs.yaml --picture schedule.svg. "
    "overflight plan uav.yaml --max-cpu 1.5 --min-rate semantic_map=9 --json"
)
def plan(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    costs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What each step costs: of overflight profile --save-costs.",
            show_default="the latencies in the file and the shipped ones",
        ),
    ] = None,
    seconds: Annotated[
        float,
        typer.Option(metavar="SECONDS", min=1.0, help="Virtual time of each assignment."),
    ] = 30.0,
    limit: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Real time for all of them. Ctrl-C stops earlier."
        ),
    ] = 60.0,
    cores: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Of the computer that flies.", show_default="the cost table's"
        ),
    ] = None,
    max_cpu: Annotated[
        float | None,
        typer.Option(
            metavar="CORES",
            min=0.0,
            help="Demand that the process takes no more.",
            show_default="the file's expect block",
        ),
    ] = None,
    min_rate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OUTPUT=HZ",
            help="Demand a rate of an output. Repeatable.",
            show_default="the file's expect block",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another draw of all times.")] = 0,
    top: Annotated[int, typer.Option(min=1, help="How many assignments the table shows.")] = 10,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the schedule of the best assignment (.svg or .png).",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Predict rates, ages, losses and load for every assignment of stages to devices.

    Runs the real scheduler in virtual time; nothing is executed. Exit code 1: no assignment meets
    the demands.
    """
    from tools.plan import plan_file

    met = plan_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        costs=costs,
        seconds=seconds,
        limit_s=limit,
        cores=cores,
        max_cpu=max_cpu,
        min_rates=min_rate or (),
        seed=seed,
        top=top,
        picture=picture,
        as_json=as_json,
    )
    if not met:
        raise typer.Exit(RUN_FAILED)


@app.command(epilog="Example: overflight doctor graphs/drive.yaml --models my_models.yaml")
def doctor(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    out: Out = Path("out"),
    as_json: AsJson = False,
) -> None:
    """Check a graph against this machine: devices, drivers, model files. Exit code 1: something is
    missing."""
    from tools.doctor import doctor_file

    ready = doctor_file(
        graph,
        settings=settings or (),
        overlays=overlays or (),
        models=models or (),
        out=out,
        as_json=as_json,
    )
    if not ready:
        raise typer.Exit(RUN_FAILED)


@app.command(epilog="Example: overflight devices --json")
def devices(as_json: AsJson = False) -> None:
    """List what this machine can run models on, and what to install for the rest."""
    from tools.devices import print_devices

    print_devices(as_json=as_json)


@app.command(name="graph", epilog="Example: overflight graph graphs/drive.yaml -o drive.svg")
def draw(
    graph: GraphFile,
    settings: Settings = None,
    overlays: Overlays = None,
    models: ModelFiles = None,
    form: Annotated[
        Drawing | None,
        typer.Option(
            "--format", help="How to draw.", show_default="the ending of -o, else mermaid"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write to a file.", show_default="print"
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print stages and edges as JSON instead of a drawing.")
    ] = False,
) -> None:
    """Draw a graph: its stages, devices and edges."""
    from tools.diagram import Diagram
    from tools.load import open_graph

    loaded, _ = open_graph(graph, settings or (), overlays or (), models or ())
    diagram = Diagram.of(loaded)
    if form is None:
        ending = output.suffix.lstrip(".") if output else ""
        form = Drawing(ending) if ending in list(Drawing) else Drawing.MERMAID
    if as_json:
        emit(diagram.json(), output)
    elif form is Drawing.SVG:
        from tools.svg import svg

        emit(svg(diagram), output)
    else:
        emit(diagram.dot() if form is Drawing.DOT else diagram.mermaid(), output)


@app.command(
    epilog="Example: overflight inspect detect, or my_stages:MyStage of the working folder"
)
def inspect(
    stage: Annotated[
        str,
        typer.Argument(
            metavar="STAGE",
            help="module:Class as in a graph file, or the short name of a shipped stage.",
            show_default=False,
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Show a stage class: what it does, its ports, its options."""
    from tools.show import find_stage, stage_json, stage_text

    cls = find_stage(stage)
    typer.echo(stage_json(cls) if as_json else stage_text(cls))


@app.command(
    epilog="Examples: overflight simulate demo -o flight.mcap; overflight simulate train-rgb "
    "--seed 101 -o city101.mcap; overflight simulate my_preset.yaml -o mine.mcap"
)
def simulate(
    preset: Annotated[
        str,
        typer.Argument(
            metavar="PRESET",
            help="demo, paper, train-rgb, train-scan, train-car, tiny, or a YAML file like those "
            "in stages/simulation.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FILE", help="The MCAP file to write."),
    ] = Path("flight.mcap"),
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Another district, other people, another flight.",
            show_default="the preset's",
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Threads that render.", show_default="one per core"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Make it anew, and replace whatever is there.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a flight with every sensor and its ground truth; the same seed, the same flight.

    A file that holds this flight already is left as it is.
    """
    from tools.simulate import simulate_file

    simulate_file(preset, output, seed=seed, jobs=jobs, force=force, as_json=as_json)


@app.command()
def stages(as_json: AsJson = False) -> None:
    """List the stage classes that ship."""
    from tools.show import stages_json, stages_text

    typer.echo(stages_json() if as_json else stages_text())


@app.command(epilog="Example: overflight schema -o graph.schema.json")
def schema(
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write to a file.", show_default="print"
        ),
    ] = None,
) -> None:
    """Print the JSON schema of the graph file, for editors."""
    from pipeline.graph.spec import graph_schema

    emit(json.dumps(graph_schema(), indent=2), output)


@app.command()
def version(as_json: AsJson = False) -> None:
    """Print the version; with --json also those of Python and the runtimes."""
    from tools.versions import own_version, versions

    typer.echo(json.dumps(versions(), indent=2) if as_json else f"overflight {own_version()}")


def print_version(wanted: bool) -> None:
    """Answer `--version` before anything else is read."""
    if wanted:
        version(as_json=False)
        raise typer.Exit


@app.callback()
def before_any_command(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Run multi-rate sensor perception from one graph file."""


def emit(text: str, output: Path | None) -> None:
    """Print the text, or write it to a file."""
    if output is None:
        typer.echo(text)
        return
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text if text.endswith("\n") else text + "\n")
    except OSError as error:
        raise typer.BadParameter(f"cannot write {output}: {error.strerror}") from None


def complain(text: str) -> None:
    """One red line on stderr."""
    typer.secho(text, fg=typer.colors.RED, err=True)


def shadowed() -> str | None:
    """A sentence if another distribution's package would be imported in place of one of ours.

    Our top-level names are generic; whatever comes first on `sys.path` wins.
    """
    home = Path(__file__).resolve().parent.parent
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        found = Path(spec.origin).resolve().parent if spec and spec.origin else None
        if found != home / name:
            return (
                f"another package '{name}' ({found or 'not importable'}) hides Overflight's in "
                f"{home}; install overflight in a virtual environment of its own"
            )
    return None


def main() -> None:
    """The console script: an error of ours is one line on stderr, any other keeps its traceback."""
    problem = shadowed()
    if problem:
        complain(problem)
        sys.exit(USER_MISTAKE)
    # numpy's linear algebra on one thread, as all of ours is; read when numpy is first imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Custom stages are imported from the working folder; last, so that it hides nothing of ours.
    sys.path.append(str(Path.cwd()))
    try:
        app()
    except GraphError as error:
        from tools.validate import print_mistakes

        print_mistakes(error.mistakes)
        sys.exit(USER_MISTAKE)
    except OverflightError as error:
        complain(str(error))
        sys.exit(RUN_FAILED if isinstance(error, (DeviceError, StageError)) else USER_MISTAKE)


if __name__ == "__main__":
    main()
