from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest
import typer

from pipeline.message import Message
from pipeline.stage import Stage
from tools.show import find_stage, shipped_stages, stage_json, stage_text, stages_json, use_of


class Weigh(Stage):
    """Weighs a number.

    By its `factor`.
    """

    stateless = True

    def __init__(self, *, factor: float, words: tuple[str, ...] = ("a",)) -> None: ...

    def process(self, number: Message[int], others: tuple[Message[str] | None, ...]) -> float: ...


def test_every_stage_class_that_ships_is_listed(root: Path) -> None:
    listed = {use_of(cls) for cls in shipped_stages()}
    for file in (root / "stages").rglob("*.py"):
        module = ".".join(file.relative_to(root).with_suffix("").parts)
        for node in ast.parse(file.read_text()).body:
            bases = [ast.unparse(base) for base in getattr(node, "bases", [])]
            if isinstance(node, ast.ClassDef) and {"Stage", "ModelStage", "Source"} & set(bases):
                is_base = node.name.startswith("_") or "ABC" in bases
                assert is_base != (f"{module}:{node.name}" in listed)


def test_every_stage_class_that_ships_states_its_contract_and_its_purpose() -> None:
    for page in json.loads(stages_json()):
        assert page["doc"], page["use"]
        assert page["inputs"] or page["outputs"], page["use"]


def test_a_short_name_is_the_class_or_its_module() -> None:
    assert (
        find_stage("detectobjects")
        is find_stage("detect")
        is find_stage("stages.detect:DetectObjects")
    )


def test_a_short_name_that_fits_several_names_them() -> None:
    with pytest.raises(typer.BadParameter, match="'emulated' may be stages"):
        find_stage("emulated")


def test_a_misspelled_name_gets_a_suggestion() -> None:
    with pytest.raises(typer.BadParameter, match="did you mean 'detect'"):
        find_stage("detekt")


def test_a_module_that_lacks_its_own_imports_is_not_called_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "half_there.py").write_text("import surely_not_installed\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ModuleNotFoundError, match="surely_not_installed"):
        find_stage("half_there:Anything")


def test_a_page_shows_ports_options_and_traits() -> None:
    page = json.loads(stage_json(Weigh))
    assert page["inputs"] == [
        {"name": "number", "payload": ["int"], "rules": []},
        {"name": "others", "payload": ["str"], "rules": ["several edges"]},
    ]
    assert page["outputs"] == [{"name": "out", "payload": ["float"]}]
    assert page["options"] == [
        {
            "name": "factor",
            "type": "float",
            "required": True,
            "default": None,
            "doc": "By its `factor`.",
        },
        {
            "name": "words",
            "type": "tuple[str, ...]",
            "required": False,
            "default": ["a"],
            "doc": "",
        },
    ]
    assert page["traits"] == ["stateless"]


def test_the_text_of_a_page_says_the_same() -> None:
    text = stage_text(Weigh)
    assert text.splitlines()[0].endswith(":Weigh   (stateless)")
    assert "Weighs a number." in text
    assert [line.split() for line in text.splitlines()[-3:]] == [
        ["Options"],
        ["factor", "float", "required", "By", "its", "`factor`."],
        ["words", "tuple[str,", "...]", "default", "['a']"],
    ]
