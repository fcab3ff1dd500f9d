from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tools import main as command
from tools.commands.options import parse_speed

Overflight = Callable[..., Any]

HELLO = """\
overflight: 1
graph: hello
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 32, height: 16}}
  lidar: {use: stages.sources.emulated:EmulatedLidar, options: {rows: 4, columns: 32, count: 5}}
  pair:
    use: my_pairing:Pair
    inputs: {scan: lidar, image: {from: camera, sync: nearest, tolerance_ms: 20}}
"""
PAIRING = """\
from pipeline.message import Message
from pipeline.stage import Stage
from stages.types import Image, Scan

class Pair(Stage):
    '''Pairs a scan with its image.'''

    def __init__(self, *, fail_at: int = -1) -> None:
        self.fail_at, self.count = fail_at, 0

    def process(self, scan: Message[Scan], image: Message[Image] | None) -> int:
        self.count += 1
        if self.count > self.fail_at >= 0:
            raise ArithmeticError("pairing is over")
        return self.count
"""


@pytest.fixture
def hello(tmp_path: Path) -> Path:
    """A graph with a stage of the working folder."""
    (tmp_path / "my_pairing.py").write_text(PAIRING)
    (tmp_path / "hello.yaml").write_text(HELLO)
    return tmp_path / "hello.yaml"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['overflight', '--help']\n"
        "from tools.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print([name for name in sys.modules if name in "
        "('numpy', 'cv2', 'numba', 'pydantic', 'yaml', 'openvino', 'onnxruntime', 'asyncio')])"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.splitlines()[-1] == "[]"
    assert "validate" in answer.stdout


@pytest.mark.parametrize("name", [name.replace("_", "-") for name in command.COMMANDS])
def test_every_command_explains_itself(overflight: Overflight, name: str) -> None:
    answer = overflight(name, "--help")
    assert answer.code == 0
    assert f"overflight {name}" in answer.out


def test_no_words_at_all_show_the_help(overflight: Overflight) -> None:
    answer = overflight()
    assert answer.code == 2
    assert "validate" in answer.out + answer.err


def test_the_version_is_the_distributions(overflight: Overflight) -> None:
    assert overflight("--version") == overflight("version")
    versions = json.loads(overflight("version", "--json").out)
    assert overflight("version").out == f"overflight {versions['overflight']}\n"
    assert versions["numpy"]


def test_ctrl_c_that_no_command_catches_is_said(
    overflight: Overflight, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("tools.versions.own_version", interrupted)
    answer = overflight("version")
    assert (answer.code, answer.out, answer.err) == (130, "", "Stopped by Ctrl-C.\n")


@pytest.mark.parametrize(("text", "speed"), [("1", 1.0), ("0.5", 0.5), ("max", None)])
def test_a_speed_is_a_factor_or_max(text: str, speed: float | None) -> None:
    assert parse_speed(text) == speed


@pytest.mark.parametrize(
    "words",
    [
        ("fly",),
        ("run",),
        ("run", "missing.yaml"),
        ("run", "hello.yaml", "--speed", "0"),
        ("run", "hello.yaml", "--speed", "fast"),
        ("run", "hello.yaml", "--speed", "nan"),
        ("run", "hello.yaml", "--duration", "-1"),
        ("run", "hello.yaml", "--duration", "long"),
        ("run", "hello.yaml", "--report", "hello.yaml/report.json"),
        ("run", "hello.yaml", "--models", "missing.yaml"),
        ("run", "hello.yaml", "--set", "stages.pair.options.fail_att=3"),
        ("run", "hello.yaml", "--set", "parameters"),
        ("run", "hello.yaml", "--overlay", "missing.yaml"),
        ("run", "."),
        ("validate", "missing.yaml"),
        ("validate", "missing.yaml", "--json"),
        ("validate", "my_pairing.py"),
        ("validate", "hello.yaml", "--set", "stages.pair.use=my_pairing:Par"),
        ("validate", "hello.yaml", "--set", "stages.pair.inputs.scan=lidra"),
        ("graph", "missing.yaml"),
        ("graph", "hello.yaml", "--format", "jpeg"),
        ("graph", "hello.yaml", "-o", "hello.yaml/graph.svg"),
        ("graph", "hello.yaml", "-o", "graph.pdf"),
        ("inspect",),
        ("inspect", "detekt"),
        ("inspect", "my_pairing:Par"),
        ("inspect", "no_such_module:Pair"),
        ("inspect", "json:JSONDecoder"),
        ("inspect", "my_pairing:"),
        ("inspect", ":Pair"),
    ],
    ids=" ".join,
)
def test_a_users_mistake_is_exit_code_2_and_no_traceback(
    overflight: Overflight, hello: Path, words: tuple[str, ...]
) -> None:
    answer = overflight(*words)
    assert answer.code == 2
    assert answer.err or "mistakes" in answer.out
    assert "Traceback" not in answer.err + answer.out


def test_validate_shows_all_mistakes_and_their_number(overflight: Overflight, hello: Path) -> None:
    text = HELLO.replace("lidar, image", "lidra, imag").replace("rows: 4", "rows: four")
    hello.write_text(text)
    answer = overflight("validate", "hello.yaml")
    *mistakes, tally = answer.err.splitlines()
    assert tally == f"{len(mistakes)} mistakes"
    assert len(mistakes) >= 3
    assert all(line.startswith("hello.yaml:") for line in mistakes)


def test_run_shows_the_same_mistakes_as_validate(overflight: Overflight, hello: Path) -> None:
    words = ("hello.yaml", "--set", "stages.pair.inputs.scan=lidra", "--set", "graph=3")
    assert overflight("run", *words) == overflight("validate", *words)


def test_validate_as_json_lists_mistakes_with_their_place(
    overflight: Overflight, hello: Path
) -> None:
    answer = overflight("validate", "hello.yaml", "--json")
    assert (answer.code, json.loads(answer.out)["valid"]) == (0, True)
    hello.write_text(HELLO.replace("scan: lidar", "scan: lidra"))
    answer = overflight("validate", "hello.yaml", "--json")
    (mistake, *_) = json.loads(answer.out)["mistakes"]
    assert answer.code == 2
    assert mistake["line"] == 8
    assert mistake["path"].startswith("stages.pair.inputs.scan")


def test_a_run_writes_its_report_and_prints_the_same(overflight: Overflight, hello: Path) -> None:
    words = ("run", "hello.yaml", "--speed", "max", "--duration", "0.5")
    answer = overflight(*words, "--report", "new/report.json", "--json")
    assert answer.code == 0, answer.err
    report = json.loads(answer.out)
    assert json.loads(Path("new/report.json").read_text()) == report
    assert report["ledger_balanced"]
    assert report["outputs"]["pair/out"]["count"] == report["stages"]["pair"]["runs"] > 0


def test_a_run_ends_with_a_table_of_its_outputs(overflight: Overflight, hello: Path) -> None:
    answer = overflight("run", "hello.yaml", "--speed", "max", "--duration", "0.5")
    assert "pair/out" in answer.out
    assert "Every message is accounted for" in answer.out


def test_a_quiet_run_says_nothing(overflight: Overflight, hello: Path) -> None:
    words = ("run", "hello.yaml", "--speed", "max", "--duration", "0.5", "--quiet")
    answer = overflight(*words)
    assert (answer.code, answer.out, answer.err) == (0, "", "")


def test_a_failed_run_is_exit_code_1_and_keeps_the_stages_traceback(
    overflight: Overflight, hello: Path
) -> None:
    words = ("run", "hello.yaml", "--speed", "max", "--duration", "0.5", "--quiet")
    answer = overflight(*words, "--set", "stages.pair.options.fail_at=2")
    assert answer.code == 1
    assert answer.err.splitlines()[-1] == (
        "pair: ArithmeticError: pairing is over (first at stamp 0.200000 s)"
    )
    assert "my_pairing.py" in answer.err


@pytest.mark.parametrize("form", ["mermaid", "dot", "svg"])
def test_a_graph_is_drawn_in_the_form_of_the_files_ending(
    overflight: Overflight, hello: Path, form: str
) -> None:
    assert overflight("graph", "hello.yaml", "-o", f"drawn.{form}").code == 0
    printed = overflight("graph", "hello.yaml", "--format", form).out
    assert Path(f"drawn.{form}").read_text() == printed
    assert "pair" in printed


def test_the_schema_is_json_and_accepts_the_graph(overflight: Overflight, hello: Path) -> None:
    import jsonschema
    import yaml

    schema = json.loads(overflight("schema").out)
    jsonschema.validate(yaml.safe_load(HELLO), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(yaml.safe_load(HELLO.replace("use:", "usee:")), schema)


def test_another_package_of_our_name_is_named_before_anything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert command.shadowed() is None
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "stages", raising=False)
    sentence = command.shadowed()
    assert sentence is not None
    assert f"another package 'stages' ({tmp_path / 'stages'})" in sentence
    with pytest.raises(SystemExit) as leaving:
        command.main()
    assert leaving.value.code == 2
