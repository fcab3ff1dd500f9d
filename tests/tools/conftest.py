"""The command as a user runs it, in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tools.main import main


@dataclass(frozen=True)
class Answer:
    """What the command left: its exit code and what it wrote."""

    code: int
    out: str
    err: str


@pytest.fixture
def overflight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Answer]:
    """Run the command in an empty working folder: ``overflight("validate", "hello.yaml")``."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def run(*words: object) -> Answer:
        monkeypatch.setattr(sys, "argv", ["overflight", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 0
        out, err = capsys.readouterr()
        return Answer(code, out, err)

    return run
