"""`overflight models`: list, check and add models, and ask what an Edge TPU would run of one."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.commands.app import examples
from tools.commands.options import AsJson, ModelFiles

if TYPE_CHECKING:
    from rich.table import Table

    from accelerators.edgetpu_check import EdgeTpuReport
    from accelerators.registry import Registry

app = typer.Typer(no_args_is_help=True, help="List, check and add models.")

NOT_RIGHT = 1


@app.command(name="list", epilog=examples("overflight models list --models my_models.yaml"))
def list_models(models: ModelFiles = None, as_json: AsJson = False) -> None:
    """List every model that a graph may name, and which of its files are here."""
    from rich.console import Console
    from rich.table import Table

    from accelerators.registry import Registry

    registry = Registry.open(*(models or ()))
    rows = [_row(registry, name) for name in registry.names()]
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("model", "head", "input", "variants", "license"):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("model", "license"))
    for row in rows:
        variants = ", ".join(
            one["kind"] + ("" if one["present"] else " (missing)") for one in row["variants"]
        )
        size = "x".join(map(str, row["input"]["shape"]))
        table.add_row(row["name"], row["head"], size, variants, row["license"])
    Console().print(table)
    if any(not one["present"] for row in rows for one in row["variants"]):
        typer.echo("missing: the file is in none of the registry's roots; see 'models check NAME'")


def _row(registry: Registry, name: str) -> dict[str, Any]:
    entry = registry.entry(name)
    return {
        "name": name,
        "description": entry.description,
        "head": entry.head.kind,
        "input": entry.input.model_dump(mode="json"),
        "license": entry.license,
        "source": entry.source,
        "variants": [
            {
                "kind": variant.kind,
                "file": variant.file,
                "present": variant.file is None or registry.find(variant.file) is not None,
            }
            for variant in entry.variants
        ],
    }


@app.command(
    epilog=examples("overflight models check", "overflight models check detect-rgb --json")
)
def check(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A model.", show_default="every model"),
    ] = None,
    models: ModelFiles = None,
    as_json: AsJson = False,
) -> None:
    """Hold the model files against the registry: sums, shapes, dtypes, and load what can be loaded.

    Exit code 1 where a file is wrong, or missing of a model that is named.
    """
    from rich.console import Console

    from accelerators.registry import Registry
    from tools.models.check import Finding, computing_devices, findings_of, findings_table

    registry = Registry.open(*(models or ()))
    names = [name] if name else list(registry.names())
    devices = list(computing_devices())
    findings: list[Finding] = []
    for model in names:
        for variant in registry.entry(model).variants:
            if not as_json:
                typer.echo(f"checking {model} ({variant.kind}) ...", err=True)
            findings += findings_of(registry, model, variant, devices)
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        Console().print(findings_table(findings))
        for finding in findings:
            if finding.state == "wrong" or (finding.state == "missing" and name):
                typer.secho(finding.said, fg=typer.colors.RED, err=True)
    wrong = {"wrong", "missing"} if name else {"wrong"}
    if any(finding.state in wrong for finding in findings):
        raise typer.Exit(NOT_RIGHT)


@app.command(
    epilog=examples(
        "overflight models add net.tflite net.onnx --name segment-mine --head scores "
        "--classes cityscapes",
        "overflight run graph.yaml --models models.yaml",
    )
)
def add(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE ...",
            help="Files of one model: .tflite, .onnx, OpenVINO .xml (its .bin beside it).",
            show_default=False,
        ),
    ],
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Its name in graph files.", show_default=False)
    ],
    registry: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="The registry file to add it to; made where it is not there."
        ),
    ] = Path("models.yaml"),
    head: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="What the outputs mean: scores, label_map, detection_output, fastestdet, ssd, "
            "ssd_postprocessed, yolo or centernet; with settings as {kind: label_map, stride: 4}.",
            show_default="asked, or guessed",
        ),
    ] = None,
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="MAP",
            help="The network's classes as ours: 0=road,1=sidewalk, or a label set as cityscapes "
            "or coco80.",
            show_default="none",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OURS=THEIRS",
            help="Which output of the file is which of the head's, e.g. boxes=concat; a .tflite "
            "may be cut at any tensor. Repeatable.",
            show_default="in the order of the file",
        ),
    ] = None,
    color: Annotated[
        str | None,
        typer.Option(
            metavar="ORDER", help="rgb, bgr or gray.", show_default="by channels: rgb or gray"
        ),
    ] = None,
    mean: Annotated[
        list[float] | None,
        typer.Option(
            metavar="X",
            help="Real input = (value - mean) / std, per channel. Repeatable.",
            show_default="the file's own quantization, or 0",
        ),
    ] = None,
    std: Annotated[
        list[float] | None,
        typer.Option(
            metavar="X", help="As above.", show_default="the file's own quantization, or 1"
        ),
    ] = None,
    description: Annotated[str, typer.Option(metavar="TEXT", show_default=False)] = "",
    license: Annotated[str, typer.Option(metavar="SPDX", show_default=False)] = "",
    source: Annotated[str, typer.Option(metavar="TEXT", show_default=False)] = "",
    replace: Annotated[
        bool, typer.Option("--replace", help="Rewrite the entry of that name, if there is one.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write a model's registry entry from its files: inputs, outputs, quantization, sums.

    Several files become variants of the one model. The rest of the registry file stays as it is.
    """
    from tools.models.add import add_model
    from tools.models.entry import Said, parse_classes, parse_head

    if color not in (None, "rgb", "bgr", "gray"):
        raise typer.BadParameter(f"'{color}' is none of rgb, bgr and gray", param_hint="--color")
    pairs = [pair.partition("=") for pair in output or ()]
    if any(not theirs for _, _, theirs in pairs):
        raise typer.BadParameter("an output looks like boxes=concat", param_hint="--output")
    said = Said(
        head=parse_head(head or _ask_head(files[0], quiet=as_json)),
        classes=parse_classes(classes) if classes else {},
        outputs={ours: theirs for ours, _, theirs in pairs},
        color=color,
        mean=mean or (),
        std=std or (),
        description=description,
        license=license,
        source=source,
    )
    written, replaced = add_model(name, files, said, registry, replace=replace)
    if as_json:
        typer.echo(json.dumps({name: written.entry, "assumed": written.assumed}, indent=2))
        return
    typer.echo(f"{registry}: {'replaced' if replaced else 'added'} {name}")
    for sentence in written.assumed:
        typer.secho(f"assumed: {sentence}", fg=typer.colors.YELLOW)
    typer.echo(f"Check it: overflight models check {name} --models {registry}")


def _ask_head(file: Path, *, quiet: bool) -> str:
    """The head's kind from a person, or a guess where nobody can be asked. Raises ModelError."""
    from pipeline.errors import ModelError
    from tools.models.entry import HEAD_OUTPUTS, guess_head

    guess = guess_head(file)
    if sys.stdin.isatty() and not quiet:
        kinds = ", ".join(HEAD_OUTPUTS)
        answer = typer.prompt(f"What do the outputs of {file.name} mean? ({kinds})", default=guess)
        return str(answer)
    if guess is None:
        raise ModelError(
            f"{file}: does not say what its outputs mean; give --head, one of "
            f"{', '.join(HEAD_OUTPUTS)}"
        )
    typer.secho(f"assumed: the head is {guess} (--head)", fg=typer.colors.YELLOW, err=True)
    return guess


@app.command(
    epilog=examples(
        "overflight models convert segment-rgb-cityscapes",
        "overflight run graphs/drive.yaml --models models.yaml --set "
        "stages.segment_rgb.executor=onnx",
    )
)
def convert(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="A model with a .tflite file.", show_default=False),
    ],
    registry: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="The registry file that gets the model's entry, with the new file beside it.",
        ),
    ] = Path("models.yaml"),
    models: ModelFiles = None,
) -> None:
    """Make a 32-bit .onnx of a model's 8-bit .tflite, for OpenVINO and ONNX Runtime.

    Needs tf2onnx: pip install 'overflight[convert]', 1.6 GB. Running the file needs nothing of it.
    """
    from rich.console import Console

    from tools.models.convert import convert_model

    with Console(stderr=True).status(f"converting {name}, half a minute"):
        made = convert_model(name, registry, models or ())
    typer.echo(f"{registry}: {name} has {made.file.name} now, for OpenVINO and ONNX Runtime")
    told = ", ".join(f"{output} {100 * part:.1f} %" for output, part in made.differences.items())
    if told:
        typer.echo(f"Of what an output varies by, it differs from the .tflite by: {told}")
    typer.echo("Before flying it, hold it against the .tflite: overflight compare GRAPH --b ...")


@app.command(
    name="check-edgetpu",
    epilog=examples("overflight models check-edgetpu net.tflite"),
)
def check_edgetpu(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A .tflite that is not compiled.", show_default=False),
    ],
    as_json: AsJson = False,
) -> None:
    """Tell which operations of a model an Edge TPU would run, where the graph is cut, and why."""
    from rich.console import Console

    from accelerators.edgetpu_check import check_file

    report = check_file(file)
    if as_json:
        page = {"mapped": report.mapped, "operations": len(report.operations)}
        page["parameter_bytes"] = report.parameter_bytes
        on_cpu = [asdict(placed) for placed in report.operations if not placed.on_device]
        typer.echo(json.dumps(page | {"on_cpu": on_cpu}, indent=2))
        return
    console = Console()
    console.print(_summary(file, report), soft_wrap=True, highlight=False)
    if report.mapped < len(report.operations):
        console.print(_cpu_table(report))


def _summary(file: Path, report: EdgeTpuReport) -> str:
    from accelerators.edgetpu_check import PARAMETER_BYTES

    every = len(report.operations)
    text = f"{file.name}: an Edge TPU would run {report.mapped} of {every} operations"
    if report.mapped:
        size = report.parameter_bytes / 2**20
        text += f", with {size:.2f} MB of parameters"
        if report.parameter_bytes > PARAMETER_BYTES:
            text += (
                f": more than the {PARAMETER_BYTES >> 20} MB on the chip, so each run loads some"
            )
    text += ".\n"
    for cut in report.cuts:
        text += f"Cut at operation {cut.number}, {cut.name} '{cut.output}': it {cut.reason}.\n"
    if not report.cuts:
        text += "Nothing cuts the graph.\n"
    return text + "Predicted from the compiler's published rules and what it did to public models."


def _cpu_table(report: EdgeTpuReport) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("on the CPU", "", "output", "because it"):
        table.add_column(heading, no_wrap=heading == "")
    for placed in report.operations:
        if not placed.on_device:
            shape = "x".join(map(str, placed.shape))
            table.add_row(str(placed.number), placed.name, shape, placed.reason)
    return table
