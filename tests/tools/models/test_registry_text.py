from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from accelerators.registry_file import SHIPPED
from pipeline.errors import ModelError
from tools.models.registry_text import with_entry

ENTRY = {"input": {"shape": [1, 2, 3]}, "variants": [{"kind": "tflite"}]}
HERE = Path("mine.yaml")


def names() -> list[str]:
    return list(yaml.safe_load(SHIPPED.read_text())["models"])


def test_an_entry_goes_to_the_end_and_every_line_before_it_stays() -> None:
    text = SHIPPED.read_text()
    after = with_entry(text, "mine", ENTRY, HERE, replace=False)
    assert after.startswith(text.rstrip("\n") + "\n")
    assert yaml.safe_load(after)["models"] == yaml.safe_load(text)["models"] | {"mine": ENTRY}


@pytest.mark.parametrize("name", names())
def test_a_replaced_entry_takes_no_other_line_with_it(name: str) -> None:
    text = SHIPPED.read_text()
    block = text.partition(f"\n  {name}:\n")[2]
    if "&" in block.partition("\n\n")[0]:
        pytest.skip("other entries refer to this one")
    after = with_entry(text, name, ENTRY, HERE, replace=True)
    assert yaml.safe_load(after)["models"] == yaml.safe_load(text)["models"] | {name: ENTRY}
    comments = [line for line in text.splitlines() if line.lstrip().startswith("#")]
    inside = [line for line in comments if line.startswith("    ") and line in block]
    kept = set(after.splitlines())
    assert all(line in kept for line in comments if line not in inside)


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("", "models:\n  mine:\n"),
        ("# Only this.\n", "# Only this.\n\nmodels:\n  mine:\n"),
        ("models: {}\n", "models:\n  mine:\n"),
        ("roots: [a]\nmodels:\n", "roots: [a]\nmodels:\n  mine:\n"),
        ("models:\n    a: {x: 1}\n", "models:\n    a: {x: 1}\n\n    mine:\n"),
        (
            "models:\n  a:\n    x: |\n      text\n",
            "models:\n  a:\n    x: |\n      text\n\n  mine:\n",
        ),
        ("models:\n  a: 1\n# end\nroots: [b]\n", "models:\n  a: 1\n\n  mine:\n"),
    ],
)
def test_it_fits_into_files_of_every_form(text: str, start: str) -> None:
    after = with_entry(text, "mine", ENTRY, HERE, replace=False)
    assert after.startswith(start)
    before = yaml.safe_load(text) or {}
    models = (before.get("models") or {}) | {"mine": ENTRY}
    assert yaml.safe_load(after) == before | {"models": models}
    assert all(line in after for line in text.splitlines() if line.startswith("#"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("models:\n  mine: 1\n", "mine.yaml: has a model 'mine' already; --replace rewrites it"),
        ("models: {a: 1}\n", "mine.yaml: 'models' is written in braces"),
        ("models: [", "mine.yaml: is not YAML"),
    ],
)
def test_what_cannot_be_added_to_is_said(text: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        with_entry(text, "mine", ENTRY, HERE, replace=False)
