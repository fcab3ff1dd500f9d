"""`make soak`: a graph of several processes at full rate, its processes killed at random, for long.

Every kill is SIGKILL, drawn by a seed. A table tells what grew, what was lost and how long outputs
were silent; anything beyond its bound ends with exit code 1.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pipeline.measuring.board import boards, read_board
from tools.load import open_graph
from tools.soaking.verdicts import Verdict, sentence, table, verdicts
from tools.soaking.watch import Watch

#: Between two looks at the run; its page is renewed twice a second.
LOOK_S = 0.1
#: A run opens its devices, and compiles kernels the first time.
OPENING_S = 180.0
#: How long it may take to end and to write its report.
ENDING_S = 60.0


def soak(
    graph: Annotated[Path, typer.Argument(help="The graph file.")] = Path(
        "graphs/uav_two_process.yaml"
    ),
    minutes: Annotated[float, typer.Option(metavar="MINUTES", min=0.5, help="How long.")] = 20.0,
    every: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=10, help="Seconds between kills, on average; drawn evenly."
        ),
    ] = 30.0,
    seed: Annotated[
        int, typer.Option(metavar="N", help="Of the times and the processes that are killed.")
    ] = 0,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="A.B.C=VALUE", help="Change the graph, as in `run`."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write what was measured there.")
    ] = None,
) -> None:
    """Run a graph and kill its processes at random; say what grew and what stayed silent.

    Ctrl-C ends it early, with the table so far.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    changes = settings or []
    owners = _owners(graph, changes)
    console = Console()
    with tempfile.TemporaryDirectory(prefix="overflight-soak-") as name:
        watch, code = _fly(
            graph, changes, owners, Path(name), minutes * 60, every, random.Random(seed)
        )
        found = Path(name) / "report.json"
        ended = json.loads(found.read_text()) if found.exists() else {}
    judged = verdicts(watch, ended, code)
    console.print(table(judged, watch))
    console.print(sentence(judged), highlight=False)
    if report is not None:
        report.write_text(json.dumps(watch.page() | {"verdicts": _page(judged)}, indent=2) + "\n")
    raise typer.Exit(0 if all(verdict.met for verdict in judged) else 1)


def _page(judged: list[Verdict]) -> list[dict[str, Any]]:
    return [verdict._asdict() for verdict in judged]


def _fly(
    graph: Path,
    settings: list[str],
    owners: Mapping[str, str],
    folder: Path,
    seconds: float,
    every: float,
    chance: random.Random,
) -> tuple[Watch, int | None]:
    """Run the graph, watched, with kills; its exit code is None where it had to be killed."""
    log = folder / "log"
    words = ["run", str(graph.absolute()), "--out", str(folder / "out"), "--quiet"]
    with log.open("w") as output:
        run = subprocess.Popen(
            [sys.executable, "-m", "tools.main", *words, "--report", str(folder / "report.json")]
            + [f"--set={setting}" for setting in settings]
            + [f"--set=processes.{name}.max_restarts=1000000" for name in set(owners.values())],
            env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is ours to hand on
        )
    watch = Watch(run.pid, owners)
    try:
        with _progress() as progress:
            task = progress.add_task("opening", total=seconds)
            _watch(run, watch, folder, seconds, every, chance, progress, task)
    except KeyboardInterrupt:
        typer.echo("Ending early ...", err=True)
    finally:
        if run.poll() is None:
            run.send_signal(signal.SIGINT)
        code: int | None
        try:
            code = run.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            run.kill()
            run.wait()
            code = None
    watch.ended()
    if code != 0:
        typer.echo(log.read_text()[-4_000:], err=True)
    return watch, code


def _watch(
    run: subprocess.Popen[bytes],
    watch: Watch,
    folder: Path,
    seconds: float,
    every: float,
    chance: random.Random,
    progress: Progress,
    task: Any,
) -> None:
    began: float | None = None
    due = 0.0
    start = time.monotonic()
    while run.poll() is None:
        now = time.monotonic()
        if began is None and now - start > OPENING_S:
            return
        if (page := _read(folder)) is not None and page.get("state") == "running":
            watch.look(page, now)
            if began is None and watch.flows:
                began, due = now, now + chance.uniform(0.5, 1.5) * every
                watch.began(now)
        if began is not None:
            if now - began >= seconds:
                return
            if now >= due and watch.all_back and now - began < seconds - every / 2:
                due = now + chance.uniform(0.5, 1.5) * every
                watch.kill(chance.choice(sorted(watch.pids)), now)
            progress.update(task, completed=now - began, description=watch.sentence())
        time.sleep(LOOK_S)


def _read(folder: Path) -> Mapping[str, Any] | None:
    for board in boards(folder / "overflight"):
        return read_board(board)
    return None


def _owners(graph: Path, settings: list[str]) -> Mapping[str, str]:
    """The process that makes each output. Raises GraphError."""
    opened, _ = open_graph(graph, settings)
    return {
        f"{node.name}/{port}": opened.placement.process_of[node.name]
        for node in opened.topology.stages
        for port in node.outputs
    }


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


if __name__ == "__main__":
    typer.run(soak)
