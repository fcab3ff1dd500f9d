"""What `overflight run` says of a run that is over: its report, tables and files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import typer
from rich.console import Console

from pipeline.drivers.run import RunResult
from pipeline.measuring.expectations import Verdict
from tools.check import verdict_table
from tools.watching.report import print_report


@dataclass(frozen=True, slots=True)
class Told:
    """One run and how it is told; with `quiet` nothing but defects."""

    result: RunResult
    judged: list[Verdict]
    as_json: bool
    quiet: bool

    def text(self) -> str:
        """The report with what was expected, as JSON."""
        judged = [asdict(verdict) for verdict in self.judged]
        return json.dumps({**self.result.report, "expectations": judged}, indent=2)

    def write(self, file: Path) -> str | None:
        """Write the report; a sentence where that fails: the run has more to tell."""
        try:
            file.write_text(self.text() + "\n")
        except OSError as error:
            return f"{file}: the report was not written: {error.strerror}"
        return None

    def defects(self) -> None:
        """Tracebacks of defects, ours or of the user's own stages: those keep theirs."""
        for event in self.result.events:
            _, newline, lines = event.text.partition("\n")
            if newline:
                typer.echo(lines, err=True)

    def tables(self, written: Iterable[Path]) -> None:
        """The report, and the files that were written."""
        if self.as_json:
            typer.echo(self.text())
        if self.as_json or self.quiet:
            return
        console = Console()
        print_report(self.result.report, console)
        if self.judged:
            console.print("\n", verdict_table(self.judged), sep="")
        if names := ", ".join(dict.fromkeys(map(str, written))):
            console.print(f"Written: {names}", highlight=False, soft_wrap=True)
