"""The words of `overflight simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.commands.app import app, examples
from tools.commands.options import AsJson


@app.command(
    epilog=examples(
        "overflight simulate demo -o flight.mcap",
        "overflight simulate train-rgb --seed 101 -o city101.mcap",
        "overflight simulate my_preset.yaml -o mine.mcap",
    )
)
def simulate(
    preset: Annotated[
        str,
        typer.Argument(
            metavar="PRESET",
            help="demo, paper, judge, train-rgb, train-scan, train-car, tiny, or a YAML file like "
            "those in stages/simulation.",
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
            metavar="N",
            min=0,
            help="Another district, other people, another flight.",
            show_default="the preset's",
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Threads that render.", show_default="one per core"),
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
