"""Whatever a file holds, the answer is a graph or a GraphError, and it comes at once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from graph_stages import Models
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import GraphError
from pipeline.graph.graph import load_graph

GOOD = Path(__file__).parent / "good_graph.yaml"
TEXT = GOOD.read_text(encoding="utf-8")

#: Words that mean something in a graph file, so that chance finds its way deep inside.
WORDS = [
    *("overflight", "graph", "stages", "devices", "parameters", "calibration", "include"),
    *("use", "options", "inputs", "executor", "model", "from", "sync", "queue", "policy", "size"),
    *(
        "image",
        "scan",
        "boxes",
        "poses",
        "thing",
        "camera",
        "lidar",
        "detect",
        "chip",
        "camera/out",
    ),
    *("graph_stages:Camera", "graph_stages:Fuse", "graph_stages:Detect", "graph_stages:Split"),
    *("graph_stages:Save", "graph_stages:Mount", "graph_stages:Chip", "graph_stages:Halves"),
    *("trigger", "exact", "nearest", "latest", "span", "hold", "missing", "tolerance_ms"),
    *(
        "rate_hz",
        "$rate",
        "$out",
        "$",
        "$$",
        "${scans}x",
        "path",
        "<<",
        "",
        "a b",
        "true",
        "\u2028",
    ),
]
words = st.one_of(st.sampled_from(WORDS), st.text(max_size=8))
scalars = st.one_of(
    words,
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(words, inner, max_size=5)),
    max_leaves=20,
)
quick = settings(
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "graph.yaml"


def survive(path: Path, *texts: str) -> None:
    sentences = ["none"]
    try:
        load_graph(path, catalog=Models(), settings=texts)
    except GraphError as error:
        sentences = [mistake.what for mistake in error.mistakes]
    assert sentences
    assert all(sentences)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    for key, child in (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    ):
        yield from places(child, (*path, key))


@quick
@given(text=st.text(max_size=200))
def test_any_text_is_a_graph_or_a_graph_error(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", errors="replace")
    survive(file)


@quick
@given(data=st.binary(max_size=100))
def test_any_bytes_are_a_graph_or_a_graph_error(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    survive(file)


@quick
@given(where=st.integers(0, len(TEXT)), length=st.integers(0, 30), put=words)
def test_a_good_file_with_a_piece_replaced_is_a_graph_or_a_graph_error(
    file: Path, where: int, length: int, put: str
) -> None:
    broken = TEXT[:where] + put + TEXT[where + length :]
    file.write_text(broken, encoding="utf-8", errors="replace")
    survive(file)


@quick
@given(
    values=st.dictionaries(
        st.sampled_from([word for word in WORDS if word != "include"]), values, max_size=6
    )
)
def test_any_structure_is_a_graph_or_a_graph_error(file: Path, values: dict[str, Any]) -> None:
    file.write_text(json.dumps(values))  # JSON is YAML
    survive(file)


@quick
@given(data=st.data(), value=values)
def test_a_good_file_with_any_value_anywhere_is_a_graph_or_a_graph_error(
    file: Path, good: dict[str, Any], data: st.DataObject, value: Any
) -> None:
    spot = data.draw(st.sampled_from([path for path in places(good) if path]))
    changed = json.loads(json.dumps(good))
    holder = changed
    for step in spot[:-1]:
        holder = holder[step]
    holder[spot[-1]] = value
    file.write_text(json.dumps(changed))
    survive(file)


@quick
@given(path=st.lists(words, min_size=1, max_size=5), value=st.one_of(words, st.text(max_size=20)))
def test_any_setting_is_a_graph_or_a_graph_error(path: list[str], value: str) -> None:
    survive(GOOD, f"{'.'.join(path)}={value}")


@pytest.mark.parametrize("bracket", ["[", "{a: ", "- ", "? ", "&a [", "!x ["])
def test_deep_nesting_is_a_mistake_and_no_crash(file: Path, bracket: str) -> None:
    file.write_text("parameters: " + bracket * 50_000)
    survive(file)


@pytest.fixture(scope="module")
def good() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(TEXT)
    return loaded
