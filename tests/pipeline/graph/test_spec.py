from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from pipeline.graph.spec import GraphSpec, graph_schema

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def good() -> Any:
    return yaml.safe_load((HERE / "good_graph.yaml").read_text(encoding="utf-8"))


def test_the_shipped_schema_is_the_one_that_the_spec_makes(root: Path) -> None:
    shipped = json.loads((root / "graphs" / "graph.schema.json").read_text(encoding="utf-8"))
    assert shipped == graph_schema(), "run: overflight schema -o graphs/graph.schema.json"


def test_the_schema_is_a_json_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(graph_schema())


def test_an_editor_accepts_a_good_graph_in_all_its_short_forms(good: Any) -> None:
    good["stages"]["blur"]["inputs"]["image"] = {"from": "camera", "rate_hz": "$rate"}
    jsonschema.validate(good, graph_schema())


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("stagess",), {}),
        (("overflight",), 2),
        (("stages", "blur", "inputs", "image"), 5),
        (("stages", "fuse", "inputs", "poses", "sync"), "neerest"),
        (("stages", "fuse", "inputs", "poses", "max_wait_ms"), -1),
        (("stages", "camera", "use"), "camera"),
        (("devices", "chip", "use"), 3),
    ],
)
def test_an_editor_underlines_what_is_wrong(good: Any, path: tuple[str, ...], value: Any) -> None:
    changed = json.loads(json.dumps(good))
    holder = changed
    for step in path[:-1]:
        holder = holder[step]
    holder[path[-1]] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(changed, graph_schema())


def test_every_key_has_a_description_for_the_hover_text() -> None:
    schema = graph_schema()
    for block in (schema, *schema["$defs"].values()):
        for key, value in block.get("properties", {}).items():
            assert value.get("description"), key


def test_specs_are_frozen() -> None:
    spec = GraphSpec(overflight=1, graph="x", stages={})
    with pytest.raises(ValueError, match="frozen"):
        spec.graph = "y"  # type: ignore[misc]
