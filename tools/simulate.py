"""`overflight simulate`: a preset to an MCAP file with every sensor and its ground truth."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

import pipeline.recording
import stages.codecs
import stages.simulation
from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD, Codec
from pipeline.recording.mcap import McapReader, McapWriter
from stages.codecs.poses import PoseCodec
from stages.codecs.registry import codec_of
from stages.labels import LabeledVoxels
from stages.simulation.simulation import Exposure, Sample, Simulation
from stages.simulation.specification import Preset, load_preset
from stages.sources.recording import write_calibration
from tools.versions import own_version

T = TypeVar("T")
R = TypeVar("R")

#: The file's note that says what it was made from.
NOTE = "simulation"
TRUTH = "truth/"
#: Samples that are being made or wait to be written, per worker.
AHEAD = 4
#: Between two lines of progress where no terminal shows a bar.
PLAIN_PERIOD_S = 5.0


def simulate_file(
    name: str,
    output: Path,
    *,
    seed: int | None = None,
    jobs: int | None = None,
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Simulate a preset into `output`, unless that holds the same flight already.

    The file is there whole or not at all. Raises DataError.
    """
    preset, folder = load_preset(name)
    if seed is not None:
        preset = preset.model_copy(update={"seed": seed})
    made_from = {
        "preset": preset.model_dump_json(),
        "generator": fingerprint(folder),
        "version": own_version(),
    }
    start, cpu = time.monotonic(), time.process_time()
    cached = not force and holds(output, made_from)
    if not cached:
        _make(preset, folder, output, made_from, jobs or len(os.sched_getaffinity(0)))
    counts = {topic: entry.count for topic, entry in McapReader(output).channels().items()}
    report = {
        "path": str(output),
        "cached": cached,
        "seed": preset.seed,
        "duration_s": preset.duration_s,
        "messages": counts,
        "bytes": output.stat().st_size,
        "wall_s": round(time.monotonic() - start, 2),
        "cpu_s": round(time.process_time() - cpu, 2),
    }
    if as_json:
        typer.echo(json.dumps(report, indent=2))
        return
    took = "is there already" if cached else f"made in {report['wall_s']:.0f} s"
    size = output.stat().st_size / 1e6
    typer.echo(f"{output}: {preset.duration_s:g} s of flight, {size:.0f} MB, {took}")


def fingerprint(folder: Path) -> str:
    """A hash of everything that decides what a preset's flight looks like: the generator, its
    codecs, and the YAML files in the preset's folder."""
    packages = (stages.simulation, stages.codecs, pipeline.recording)
    files = {
        file
        for package in packages
        for file in Path(next(iter(package.__path__))).rglob("*.*")
        if file.suffix in (".py", ".yaml")
    }
    files |= set(folder.glob("*.yaml"))
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def holds(output: Path, made_from: dict[str, str]) -> bool:
    """Whether a file holds exactly this flight. Raises DataError where it is another's file."""
    if not output.exists():
        return False
    try:
        note = McapReader(output).notes().get(NOTE)
    except DataError:
        note = None
    if note is None:
        raise DataError(
            f"{output} exists and is no simulated flight; give another -o, or --force to replace it"
        )
    return note == made_from


def _make(preset: Preset, folder: Path, output: Path, made_from: dict[str, str], jobs: int) -> None:
    """Simulate into a file beside `output`, which takes its name at the end."""
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot write {output}: {error.strerror}") from error
    partial = output.with_name(f".{output.name}.partial")
    console = Console(stderr=True)
    try:
        with console.status("building the district (the first run compiles kernels) ..."):
            simulation = Simulation(preset, folder)
        with McapWriter(partial) as file:
            _write(simulation, file, console, jobs)
            file.note(NOTE, made_from)
        partial.replace(output)
    finally:
        partial.unlink(missing_ok=True)


def _write(simulation: Simulation, file: McapWriter, console: Console, jobs: int) -> None:
    write_calibration(file, simulation.rig.calibration())
    turns = simulation.exposures()

    def make(turn: Exposure) -> list[tuple[Sample, bytes]]:
        return [
            (sample, codec_on(sample).encode(sample.message)) for sample in simulation.take(turn)
        ]

    seconds = simulation.preset.duration_s
    with _progress(console, seconds) as at:
        for made in in_order(make, turns, jobs):
            for sample, data in made:
                _append(file, sample, data)
            at(made[0][0].message.received / 1e9)
    if not simulation.preset.true_map:
        return
    told = "making the true map: seconds to some minutes, by the length of the way ..."
    if not console.is_terminal:
        console.print(told)
    end = round(seconds * 1e9)
    with console.status(told):
        voxels: Message[LabeledVoxels] = Message.at(end, simulation.voxels())
    sample = Sample(f"{TRUTH}map", voxels)
    _append(file, sample, codec_on(sample).encode(voxels))


def codec_on(sample: Sample) -> Codec:
    """The codec of a sample; the true pose is a frame of its own beside the reported one."""
    if sample.topic == f"{TRUTH}pose":
        return PoseCodec("base_true")
    return codec_of(sample.message.payload)


def _append(file: McapWriter, sample: Sample, data: bytes) -> None:
    message = sample.message
    if not file.has_channel(sample.topic):
        payload = type(message.payload).__name__
        file.add_channel(sample.topic, codec_on(sample).schema, {PAYLOAD: payload})
    file.write(sample.topic, data, received=message.received, stamp=message.stamp)


def in_order(work: Callable[[T], R], items: Iterable[T], workers: int) -> Iterator[R]:
    """The results of `work`, done by threads, in the order of the items.

    At most `AHEAD` items per worker are begun and not yet taken. Closing it early, as Ctrl-C does,
    waits only for what has begun.
    """
    with ThreadPoolExecutor(workers, thread_name_prefix="simulate") as pool:
        begun: deque[Any] = deque()
        try:
            for item in items:
                begun.append(pool.submit(work, item))
                if len(begun) >= AHEAD * workers:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            for future in begun:
                future.cancel()


@contextmanager
def _progress(console: Console, seconds: float) -> Iterator[Callable[[float], None]]:
    """Show how far the simulated time is: a bar on a terminal, else a line now and then."""
    if not console.is_terminal:
        due = time.monotonic() + PLAIN_PERIOD_S

        def say(at_s: float) -> None:
            nonlocal due
            if time.monotonic() >= due:
                due = time.monotonic() + PLAIN_PERIOD_S
                console.print(f"{at_s:6.1f} of {seconds:g} s simulated")

        yield say
        return
    columns = (
        TextColumn("simulating"),
        BarColumn(),
        TextColumn("{task.completed:.1f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=seconds)
        yield lambda at_s: bar.update(task, completed=min(at_s, seconds))
