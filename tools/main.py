"""The command `overflight`: gathers its commands, runs one, and gives the exit code.

Each command's words are in `tools/commands/`. Everything heavy is imported inside the command that
needs it, so that `--help` answers at once.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import DeviceError, GraphError, OverflightError, StageError
from tools.commands.app import INTERRUPTED, RUN_FAILED, USER_MISTAKE, app, complain
from tools.models.commands import app as models_app
from tools.train.commands import app as train_app

PACKAGES = ("pipeline", "accelerators", "stages", "graphs", "tools")

#: In the order of `--help`: fly, look at what flew, prepare, look things up.
COMMANDS = (
    *("run", "top", "check", "validate", "plan", "profile", "compare", "doctor"),
    *("info", "explain"),
    *("evaluate", "evaluate_detections", "statistics", "simulate", "propagate"),
    *("graph", "inspect", "stages", "devices", "schema", "version"),
)

for name in COMMANDS:
    importlib.import_module(f"tools.commands.{name}")
app.add_typer(models_app, name="models")
app.add_typer(train_app, name="train")


def print_version(wanted: bool) -> None:
    """Answer `--version` before anything else is read."""
    if wanted:
        from tools.commands.version import version

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


def _unsaid(leaving: SystemExit) -> bool:
    """Whether no command has caught the Ctrl-C: it is typer that leaves, and says nothing."""
    told = leaving.__context__
    return told is not None and isinstance(told.__cause__, KeyboardInterrupt)


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
    except SystemExit as leaving:
        if leaving.code == INTERRUPTED and _unsaid(leaving):
            complain("Stopped by Ctrl-C.")
        raise
    except GraphError as error:
        from tools.validate import print_mistakes

        print_mistakes(error.mistakes)
        sys.exit(USER_MISTAKE)
    except OverflightError as error:
        complain(str(error))
        sys.exit(RUN_FAILED if isinstance(error, (DeviceError, StageError)) else USER_MISTAKE)


if __name__ == "__main__":
    main()
