"""Imports go down only, and each third-party runtime is imported in exactly one file."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("pipeline", "accelerators", "stages", "graphs", "tools")
FILES = [file for floor in FLOORS for file in sorted((ROOT / floor).rglob("*.py"))]

#: What drives a device, a network or a recording; numpy and its like are no runtimes.
RUNTIMES = {
    "ai_edge_litert",
    "mcap",
    "onnxruntime",
    "openvino",
    "ouster",
    "tflite_runtime",
    "zenoh",
}


def imports(file: Path) -> Iterator[str]:
    """The modules that a file imports, wherever in it, by their full names."""
    for node in ast.walk(ast.parse(file.read_text(), str(file))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno} imports relatively"
            yield node.module or ""
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name | ast.Attribute)
            and (node.func.id if isinstance(node.func, ast.Name) else node.func.attr)
            in ("import_module", "__import__")
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            yield str(node.args[0].value)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_a_file_imports_only_its_own_floor_and_those_below(file: Path) -> None:
    floor = FLOORS.index(file.relative_to(ROOT).parts[0])
    upward = [name for name in imports(file) if name.split(".")[0] in FLOORS[floor + 1 :]]
    assert not upward, f"{file.relative_to(ROOT)} imports upward: {', '.join(upward)}"


def test_the_scheduler_imports_nothing_of_the_framework_above_it() -> None:
    allowed = {"pipeline.scheduling", "pipeline.message", "pipeline.errors"}
    for file in sorted((ROOT / "pipeline/scheduling").glob("*.py")):
        for name in imports(file):
            if name.split(".")[0] in FLOORS:
                waist = ".".join(name.split(".")[:2])
                assert waist in allowed, f"{file.relative_to(ROOT)} imports {name}"


def test_the_pure_machine_knows_no_thread_no_clock_and_no_file() -> None:
    impure = {"threading", "time", "queue", "asyncio", "os", "pathlib", "socket", "subprocess"}
    for file in sorted((ROOT / "pipeline/scheduling").glob("*.py")):
        found = impure & {name.split(".")[0] for name in imports(file)}
        assert not found, f"{file.relative_to(ROOT)} imports {', '.join(found)}"


def test_kernels_stand_on_numpy_numba_and_opencv_alone() -> None:
    for file in sorted((ROOT / "stages/kernels").glob("*.py")):
        above = [
            name
            for name in imports(file)
            if name.split(".")[0] in FLOORS and not name.startswith("stages.kernels")
        ]
        assert not above, f"{file.relative_to(ROOT)} imports {', '.join(above)}"


def test_torch_is_imported_only_where_networks_are_trained() -> None:
    outside = [
        str(file.relative_to(ROOT))
        for file in FILES
        if "torch" in {name.split(".")[0] for name in imports(file)}
        and file.relative_to(ROOT).parts[:2] != ("tools", "train")
    ]
    assert not outside


def test_each_runtime_is_imported_in_exactly_one_file() -> None:
    users: dict[str, set[str]] = defaultdict(set)
    for file in FILES:
        for name in imports(file):
            runtime = name.split(".")[0]
            if runtime in RUNTIMES:
                users[runtime].add(str(file.relative_to(ROOT)))
    shared = {runtime: files for runtime, files in users.items() if len(files) > 1}
    assert not shared, f"imported in more than one file: {shared}"
