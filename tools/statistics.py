"""`overflight statistics`: what the channels of a sensor's range images are normalized with."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table

from pipeline.errors import DataError
from pipeline.message import Message
from stages.kernels.channel_moments import mean_and_std, moments
from stages.scan_image import RangeImage
from stages.scan_statistics import SHIPPED, ScanStatistics
from stages.sinks.whole_file import whole_file
from stages.types import Scan
from tools.scan_source import open_scans

CHANNELS = {"range": "m", "x": "m", "y": "m", "z": "m", "remission": "0..1"}

#: Nearer points are the vehicle's own: they tell neither the field of view nor what it sees.
NEAR_M = 1.0


@dataclass(slots=True)
class Tally:
    """What was seen of a recording."""

    elevation_deg: tuple[float, float]
    moments: NDArray[np.float64]  #: (3, 5)
    scans: int = 0
    points: int = 0  #: with a return, those of the vehicle itself too
    outside: int = 0  #: of these, in no cell
    cells: int = 0
    remission: bool = False  #: some scan carried it
    interrupted: bool = False

    @property
    def filled(self) -> float:
        """The share of the cells with a return."""
        return float(self.moments[0, 0] / self.cells)

    def statistics(self) -> ScanStatistics:
        """Of all that was seen."""
        lowest, highest = map(float, np.radians(self.elevation_deg))
        return ScanStatistics((lowest, highest), *mean_and_std(self.moments))


def statistics_of(
    recording: Path,
    *,
    source: str | None,
    settings: Sequence[str],
    name: str | None,
    adapt: str | None,
    keep_remission: bool,
    size: tuple[int, int],
    elevation_deg: tuple[float, float] | None,
    scans: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Measure, print, and write an entry where asked to. Raises DataError naming the file."""
    if keep_remission and adapt is None:
        raise typer.BadParameter("--keep-remission says how to --adapt a network; name its entry")
    if elevation_deg is not None and not -90 <= elevation_deg[0] < elevation_deg[1] <= 90:
        raise typer.BadParameter("--elevation takes the lowest and then the highest angle, in deg")
    network = None if adapt is None else _entry(adapt, output)
    held = _held(output)
    with open_scans(recording, source, settings) as opened:
        messages = islice(opened.messages(), scans)
        tally = measure(messages, size, elevation_deg, Console(stderr=True))
    if not tally.moments[0, 0]:
        raise DataError(f"{recording}: has no scan with a return in the field of view")
    own = tally.statistics()
    fitted = network and network.adapted_to(own, remission=not keep_remission)
    name = name or recording.stem
    told = [f"{recording.name}, {_count(tally.scans)}", *settings]
    if adapt is not None:
        kept = "range, x, y and remission" if keep_remission else "range, x and y"
        told.append(f"{kept} of {adapt}")
    measured_on = "; ".join(told)
    if as_json:
        facts = {"sensor": name, "measured_on": measured_on, "adapted_from": adapt}
        typer.echo(json.dumps(facts | _values(size, tally, own, fitted), indent=2))
    else:
        _print(size, tally, own, fitted)
    if output is not None:
        _write(output, held, fitted or own, name, measured_on)
        if not as_json:
            typer.echo(f"\nWritten: {output}, entry '{name}'")


def measure(
    messages: Iterator[Message[Scan]],
    size: tuple[int, int],
    elevation_deg: tuple[float, float] | None,
    console: Console,
) -> Tally:
    """Add up the range images of the scans; Ctrl-C ends it with those seen so far."""
    none, one = np.zeros(5, dtype=np.float32), np.ones(5, dtype=np.float32)
    tally = Tally(elevation_deg or (0.0, 0.0), np.zeros((3, 5)))
    image: RangeImage | None = None
    with _progress(console) as advance:
        try:
            for message in messages:
                scan = message.payload
                if not isinstance(scan, Scan):  # a topic may hold anything
                    raise DataError(f"{type(scan).__name__} is no scan; name another --set topic=")
                if image is None:
                    if elevation_deg is None:
                        tally.elevation_deg = elevation_of(scan.points)
                    lowest, highest = map(float, np.radians(tally.elevation_deg))
                    image = RangeImage(size, (lowest, highest))
                tally.moments += moments(image.channels(scan, none, one), NEAR_M)
                _, cell, distance = image.places(scan)
                tally.scans += 1
                tally.points += int(np.count_nonzero(distance))
                tally.outside += int(np.count_nonzero((cell < 0) & (distance > 0)))
                tally.cells += size[0] * size[1]
                tally.remission |= scan.remission is not None
                advance()
        except KeyboardInterrupt:
            if not tally.scans:
                raise
            tally.interrupted = True
    return tally


def elevation_of(points: NDArray[np.float32]) -> tuple[float, float]:
    """The lowest and the highest elevation of points (n, 3) in degrees, outward to a tenth."""
    x, y, z = points.astype(np.float64).T
    distance = np.hypot(np.hypot(x, y), z)
    away = (distance > NEAR_M) & (distance < np.inf)
    if not away.any():
        raise DataError("the first scan has no return to tell the field of view; give --elevation")
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y))[away]) * 10
    return float(np.floor(elevation.min()) / 10), float(np.ceil(elevation.max()) / 10)


def _entry(name: str, output: Path | None) -> ScanStatistics:
    """The entry to adapt: of the file that is written to, else of the shipped one."""
    if output is not None and output.is_file():
        with suppress(DataError):
            return ScanStatistics.read(output, name)
    return ScanStatistics.read(SHIPPED, name)


def _held(output: Path | None) -> str:
    try:
        return "" if output is None or not output.exists() else output.read_text(encoding="utf-8")
    except OSError as error:
        raise typer.BadParameter(f"cannot read {output}: {error.strerror}") from None


def _write(
    output: Path, held: str, statistics: ScanStatistics, name: str, measured_on: str
) -> None:
    try:
        text = statistics.written_to(held, name, measured_on)
    except ValueError as error:
        raise DataError(f"{output}: {error}; write to another file") from None
    try:
        with whole_file(output) as file:
            file.write(text.encode())
    except OSError as error:
        raise typer.BadParameter(f"cannot write {output}: {error.strerror}") from None


@contextmanager
def _progress(console: Console) -> Iterator[Any]:
    """A line that counts scans: how many there will be, a stream does not say."""
    columns = (SpinnerColumn(), TextColumn("{task.completed} scans (Ctrl-C: enough)"))
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=None)
        yield lambda: progress.advance(task)


def _print(
    size: tuple[int, int], tally: Tally, own: ScanStatistics, fitted: ScanStatistics | None
) -> None:
    table = Table("channel", box=None, pad_edge=False, header_style="bold")
    for column in ("mean", "std", *(("adapted mean", "adapted std") if fitted else ())):
        table.add_column(column, justify="right")
    table.add_column("")
    for k, (channel, unit) in enumerate(CHANNELS.items()):
        shown = [own.mean[k], own.std[k], *((fitted.mean[k], fitted.std[k]) if fitted else ())]
        table.add_row(channel, *(f"{value:.3f}" for value in shown), unit)
    lowest, highest = tally.elevation_deg
    lines = [
        f"{_count(tally.scans)} as images of {size[0]} x {size[1]} over {lowest:g} .. {highest:g} "
        f"deg; {tally.filled:.0%} of the cells have a return."
    ]
    if (share := tally.outside / tally.points) >= 1e-4:
        lines.append(f"{share:.2%} of the points lie above or below: --elevation widens the view.")
    if not tally.remission:
        lines.append("The scans carry no remission: its channel will be 0.")
    if tally.interrupted:
        lines.append("Stopped by Ctrl-C: the figures are those of the scans so far.")
    console = Console(highlight=False)
    console.print(table)
    console.print("", *lines, sep="\n", soft_wrap=True)


def _values(
    size: tuple[int, int], tally: Tally, own: ScanStatistics, fitted: ScanStatistics | None
) -> dict[str, Any]:
    def rows(statistics: ScanStatistics) -> dict[str, Any]:
        return {
            channel: {"mean": float(statistics.mean[k]), "std": float(statistics.std[k])}
            for k, channel in enumerate(CHANNELS)
        }

    return {
        "scans": tally.scans,
        "interrupted": tally.interrupted,
        "size": size,
        "elevation_deg": tally.elevation_deg,
        "points": tally.points,
        "points_outside": tally.outside,
        "cells_filled": tally.filled,
        "remission": tally.remission,
        "channels": rows(own),
        "adapted": fitted and rows(fitted),
    }


def _count(scans: int) -> str:
    return f"{scans} scan{'s' * (scans != 1)}"
