"""Every code block of README.md runs: files are written, commands run, shown output compared."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with the files that the README shows; a block's first comment names it."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "graphs").symlink_to(ROOT / "graphs")
    for language, text in BLOCKS:
        if language in ("yaml", "python"):
            name = text.splitlines()[0].removeprefix("# ")
            (folder / name).write_text(text)
    return folder


def lines_of(language: str) -> list[str]:
    """The lines in all blocks of this language, without their comments."""
    lines = [line for kind, text in BLOCKS if kind == language for line in text.splitlines()]
    return [line.split("  #")[0] for line in lines]


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What a shell in this folder, with the virtual environment active, makes of it."""
    script = f'overflight() {{ {shlex.quote(sys.executable)} -m tools.main "$@"; }}\n{command}'
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


def test_every_block_says_its_language() -> None:
    assert BLOCKS
    assert {language for language, _ in BLOCKS} <= {"sh", "yaml", "python", "console"}


def test_files_shown_are_named_in_their_first_line() -> None:
    for language, text in BLOCKS:
        if language in ("yaml", "python"):
            assert re.match(r"# \w+\.(yaml|py)$", text.splitlines()[0])


@pytest.mark.parametrize("line", [line for line in lines_of("sh") if line.startswith("make ")])
def test_a_make_target_of_the_readme_exists(line: str) -> None:
    assert re.search(rf"^{line.split()[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for line in lines_of("sh") if not line.startswith("make ")])
def test_a_command_of_the_readme_runs(line: str, folder: Path) -> None:
    answer = run(line, folder)
    assert answer.returncode == 0, answer.stdout


@pytest.mark.slow
@pytest.mark.parametrize("block", [text for kind, text in BLOCKS if kind == "console"])
def test_a_command_of_the_readme_prints_what_is_shown(block: str, folder: Path) -> None:
    commands = [line.removeprefix("$ ") for line in block.splitlines() if line.startswith("$ ")]
    shown = [line for line in block.splitlines() if not line.startswith("$ ")]
    assert run("\n".join(commands), folder).stdout.splitlines() == shown


def test_every_file_that_the_readme_links_to_exists() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize(
    "page", ["ARCHITECTURE.md", "CONTRIBUTING.md", "README.md", "tools/propagation/README.md"]
)
def test_every_file_that_a_page_names_exists(page: str) -> None:
    folders = "pipeline|accelerators|stages|graphs|tools|tests"
    named = re.findall(rf"`((?:{folders})/[\w./]+)`", (ROOT / page).read_text())
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing


def test_every_make_target_is_named_in_the_readme() -> None:
    targets = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text(), re.MULTILINE)
    missing = [target for target in targets if f"make {target}" not in README and target != "help"]
    assert not missing
