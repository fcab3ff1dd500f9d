"""`overflight train`: the words of its commands. Torch is imported only when one of them runs."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import DataError, ModelError
from tools.commands.app import INTERRUPTED, examples
from tools.train.options import (
    AsItIs,
    Attribution,
    Backbone,
    BackboneName,
    Data,
    Flight,
    Head,
    HeadName,
    JudgedOn,
    License,
    Output,
    Restart,
    ScanData,
    Seed,
    SegmenterName,
    Start,
    Steps,
    Threads,
    Width,
    Zoom,
)

if TYPE_CHECKING:
    from rich.console import Console

    from tools.train.plan import Order

app = typer.Typer(
    no_args_is_help=True,
    help="Train the networks on flights and annotated pictures (extras train and export).",
)

SIMULATED = "simulated flights of Overflight"
STATISTICS = Path(__file__).resolve().parents[2] / "stages" / "scan_statistics.yaml"


def _detector_command(
    name: str,
    told: str,
    steps: int,
    head: HeadName,
    license: str,
    attribution: str,
    *lines: str,
) -> None:
    """The command of one detector; they differ in what is `told` of them and their defaults."""

    def train(
        data: Data,
        output: Output = Path(f"out/{name}"),
        steps: Steps = steps,
        seed: Seed = 0,
        backbone: Backbone = BackboneName.RESIDUAL,
        head: Head = head,
        threads: Threads = 1,
        license: License = license,
        attribution: Attribution = attribution,
        judge: JudgedOn = None,
        start: Start = None,
        zoom: Zoom = None,
        restart: Restart = False,
        as_it_is: AsItIs = False,
    ) -> None:
        _need_torch()
        words = _detector_words(backbone, head, zoom)
        order = _order(
            name,
            data,
            output,
            steps,
            seed,
            threads,
            license,
            attribution,
            words,
            judge,
            start=start,
            restart=restart,
            as_it_is=as_it_is,
        )
        _detector(name, order, backbone, head, zoom)

    app.command(name, help=told, epilog=examples(*lines))(train)


_detector_command(
    "detect-thermal",
    "Train the thermal detector: persons, vehicles and bicycles at 640 x 512, one channel.",
    3600,
    HeadName.CENTERNET,
    "not stated",
    "not stated",
    "overflight train detect-thermal --data thermal_frames --license 'CC BY 4.0' -o out/thermal",
    "overflight train detect-thermal --data my_frames --from detect-thermal -o out/mine",
    "overflight run graph.yaml --models out/thermal/models.yaml",
)
_detector_command(
    "detect-rgb",
    "Train the color detector: persons, vehicles and bicycles at 848 x 480.",
    3000,
    HeadName.SSD,
    "Apache-2.0",
    SIMULATED,
    "overflight train detect-rgb --data city101.mcap --steps 3000 -o out/rgb",
)


@app.command(
    epilog=examples("overflight train segment-rgb --data city101.mcap --steps 4000 -o out/rgb")
)
def segment_rgb(
    data: Flight,
    output: Output = Path("out/segment-rgb"),
    steps: Steps = 4000,
    seed: Seed = 0,
    network: Annotated[
        SegmenterName,
        typer.Option(help="pyramid sees thin things and learns faster; deeplab is the paper's."),
    ] = SegmenterName.PYRAMID,
    width: Annotated[
        float, typer.Option(metavar="X", min=0.1, max=2.0, help="All channels of a deeplab.")
    ] = 1.0,
    stride: Annotated[
        int | None,
        typer.Option(metavar="N", help="Of the scores, pixels.", show_default="4, of a deeplab 8"),
    ] = None,
    threads: Threads = 1,
    license: License = "Apache-2.0",
    attribution: Attribution = SIMULATED,
    start: Start = None,
    restart: Restart = False,
    as_it_is: AsItIs = False,
) -> None:
    """Train a feature pyramid or DeepLabv3+ to segment color images of 848 x 480."""
    _need_torch()
    from tools.train.segment import train_image_segmenter

    deeplab = network is SegmenterName.DEEPLAB
    stride = stride or (8 if deeplab else 4)
    strides = (8, 16) if deeplab else (4, 8, 16)
    if stride not in strides:
        known = ", ".join(map(str, strides))
        raise typer.BadParameter(f"{network} has {known}, not {stride}", param_hint="--stride")
    words = [f"--network={network}", f"--stride={stride}"]
    if deeplab:
        words.append(f"--width={width:g}")
    order = _order(
        "segment-rgb",
        data,
        output,
        steps,
        seed,
        threads,
        license,
        attribution,
        words,
        start=start,
        restart=restart,
        as_it_is=as_it_is,
    )
    _carry_out(order, lambda console: train_image_segmenter(order, network, width, stride, console))


@app.command(
    epilog=examples(
        "overflight train segment-scan --data city101.mcap --steps 3000 -o out/scan",
        "overflight train segment-scan --data mix.yaml --recipe strong --batch 64 --from "
        "out/scan -o out/more",
        "  with mix.yaml: {sources: [{path: city101.mcap, share: 1}, {path: labels, share: 2}]}",
    )
)
def segment_scan(
    data: ScanData,
    output: Output = Path("out/segment-scan"),
    steps: Steps = 3000,
    seed: Seed = 0,
    width: Width = 0.5,
    sensor: Annotated[
        str, typer.Option(metavar="NAME", help="The entry of the statistics to normalize with.")
    ] = "os0_128",
    statistics: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="See 'overflight statistics'.", show_default="the shipped ones"
        ),
    ] = STATISTICS,
    recipe: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="How scans are varied: plain, strong, across-sensors.",
            show_default="as flights are learned from",
        ),
    ] = None,
    channels: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=4,
            max=5,
            help="4 leaves the remission out: another LiDAR's differs.",
            show_default="5; 4 for a mixture with a source of another sensor",
        ),
    ] = None,
    batch: Annotated[
        int,
        typer.Option(
            metavar="N", min=4, help="Parts of scans to a step; gathered where it is above 4."
        ),
    ] = 4,
    threads: Threads = 1,
    license: License = "Apache-2.0",
    attribution: Attribution = SIMULATED,
    start: Start = None,
    restart: Restart = False,
    as_it_is: AsItIs = False,
) -> None:
    """Train SalsaNext to segment LiDAR scans as range images of 512 x 64.

    On a simulated flight, or with --recipe on any labeled scans: a sequence of 'overflight
    propagate', SemanticKITTI, Paris-CARLA-3D, or a mixture of several as a YAML file.
    """
    _need_torch()
    from tools.train.scan_training import AT_ONCE, ScanChoices, train_from_points
    from tools.train.segment_scan import train_scan_segmenter

    if batch % AT_ONCE:
        raise typer.BadParameter(f"{batch} is no multiple of {AT_ONCE}", param_hint="--batch")
    flights = data.suffix == ".mcap" or (data.is_dir() and any(data.glob("*.mcap")))
    from_points = recipe is not None or not flights
    if not from_points and (channels not in (None, 5) or batch != AT_ONCE):
        raise typer.BadParameter("--channels and --batch need a --recipe as well")
    words = [f"--width={width:g}", f"--sensor={sensor}"]
    if from_points:
        recipe = recipe or "plain"
        words += [f"--recipe={recipe}", f"--batch={batch}"]
        words += [] if channels is None else [f"--channels={channels}"]
    order = _order(
        "segment-scan",
        data,
        output,
        steps,
        seed,
        threads,
        license,
        attribution,
        words,
        start=start,
        restart=restart,
        as_it_is=as_it_is,
    )
    order = replace(order, gathered=batch // AT_ONCE)
    if not from_points:
        _carry_out(
            order, lambda console: train_scan_segmenter(order, width, statistics, sensor, console)
        )
        return
    choices = ScanChoices(width, sensor, statistics, recipe or "plain", channels)
    _carry_out(order, lambda console: train_from_points(order, choices, console))


def _order(
    name: str,
    data: Path,
    output: Path,
    steps: int,
    seed: int,
    threads: int,
    license: str,
    attribution: str,
    words: list[str],
    judged_on: Path | None = None,
    *,
    start: Path | None,
    restart: bool,
    as_it_is: bool,
) -> Order:
    from tools.train.plan import Order

    said = ["overflight", "train", name, "--data", data.name]
    said += ["--steps", str(steps), "--seed", str(seed), *words]
    said += [] if start is None else ["--from", start.name]
    return Order(
        data=data,
        output=output,
        steps=steps,
        seed=seed,
        threads=threads,
        license=license,
        attribution=attribution,
        judged_on=judged_on,
        start=_start(start),
        restart=restart,
        as_it_is=as_it_is,
        command=shlex.join(said),
    )


def _start(start: Path | None) -> Path | None:
    """The folder or file of what a training begins with. Raises DataError, ModelError."""
    if start is None or start.is_dir() or start.suffix == ".xml":
        return start
    from accelerators.registry import Registry

    registry, name = Registry.open(), str(start)
    variants = registry.entry(name).variants if name in registry.names() else ()
    for variant in variants:
        if variant.kind == "openvino":
            return registry.files(name, variant)[0]
    raise DataError(
        f"--from {start}: no folder of a training, no .xml file, and no network that ships as one"
    )


def _detector_words(
    backbone: BackboneName, head: HeadName, zoom: tuple[float, float] | None
) -> list[str]:
    words = [f"--backbone={backbone}", f"--head={head}"]
    if zoom is not None:
        words += ["--zoom", *(f"{one:g}" for one in zoom)]
    return words


def _detector(
    name: str,
    order: Order,
    backbone: BackboneName,
    head: HeadName,
    zoom: tuple[float, float] | None,
) -> None:
    from tools.train.detect import train_detector
    from tools.train.recipes import DETECTORS

    recipe = DETECTORS[name]
    if zoom is not None:
        if not 0.5 <= zoom[0] <= zoom[1] <= 8:
            raise typer.BadParameter("rises, from 0.5 on and up to 8", param_hint="--zoom")
        recipe = replace(recipe, augmentation=replace(recipe.augmentation, zoom=zoom))
    _carry_out(
        order, lambda console: train_detector(recipe, order, backbone.value, head.value, console)
    )


def _carry_out(order: Order, train: Callable[[Console], Path]) -> None:
    """Train and say what there is; where Ctrl-C stops it, say how to go on."""
    from rich.console import Console

    from tools.train.loop import Interrupted

    try:
        registry = train(Console(stderr=True))
    except Interrupted as stop:
        typer.echo(
            f"Stopped at step {stop.step} of {order.steps}; saved in {order.output}. The same "
            "command goes on from there.",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(f"Written: {registry}. Use it with --models {registry}.")


def _need_torch() -> None:
    try:
        import torch  # noqa: F401
    except ImportError:
        raise ModelError(
            "training needs torch: pip install 'overflight[train]' (and 'overflight[export]' for "
            "8-bit files)"
        ) from None
