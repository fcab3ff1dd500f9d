"""The application that every command joins, its exit codes, and how it speaks."""

from __future__ import annotations

from pathlib import Path

import typer

RUN_FAILED = 1
USER_MISTAKE = 2
INTERRUPTED = 130

app = typer.Typer(
    name="overflight",
    epilog="Exit codes: 0 well, 1 a run failed, 2 a mistake in the file or the words, 130 Ctrl-C.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def examples(*lines: str) -> str:
    """The end of a command's help: what one may type, a line each."""
    return "\n".join(["Examples:" if len(lines) > 1 else "Example:", *lines])


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
