from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tiny_models import write_onnx, write_openvino, write_tflite

from accelerators.registry import Registry

Overflight = Callable[..., Any]
COMPILED = "deeplabv3_mnv2_dm05_pascal_quant_edgetpu.tflite"


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A folder with one network in two forms."""
    write_tflite(tmp_path / "tiny.tflite")
    write_onnx(tmp_path / "tiny.onnx")
    return tmp_path


def add(overflight: Overflight, *words: object) -> Any:
    classes = ("--head", "scores", "--classes", "0=road,1=building,2=vehicle")
    return overflight("models", "add", *words, "--name", "tiny", *classes)


def test_the_list_names_every_model_with_its_variants(overflight: Overflight) -> None:
    rows = json.loads(overflight("models", "list", "--json").out)
    assert [row["name"] for row in rows] == list(Registry.open().names())
    shipped = next(row for row in rows if row["name"] == "segment-scan")
    assert shipped["head"] == "scores"
    assert shipped["input"]["shape"] == [64, 512, 5]
    assert shipped["variants"][0]["file"] == "segment-scan_int8.tflite"
    assert shipped["variants"][-1] == {"kind": "emulated", "file": None, "present": True}
    assert "segment-scan" in overflight("models", "list").out


def test_the_list_says_which_files_are_missing(overflight: Overflight, tiny: Path) -> None:
    assert add(overflight, "tiny.tflite", "tiny.onnx").code == 0
    (tiny / "tiny.onnx").unlink()
    rows = json.loads(overflight("models", "list", "--models", "models.yaml", "--json").out)
    variants = next(row for row in rows if row["name"] == "tiny")["variants"]
    assert [(one["kind"], one["present"]) for one in variants] == [
        ("tflite", True),
        ("onnx", False),
    ]


def test_an_added_model_is_checked_and_loads_on_every_runtime(
    overflight: Overflight, tiny: Path
) -> None:
    assert add(overflight, "tiny.tflite", "tiny.onnx").code == 0
    answer = overflight("models", "check", "tiny", "--models", "models.yaml", "--json")
    findings = json.loads(answer.out)
    assert answer.code == 0
    assert {finding["state"] for finding in findings} == {"well"}
    runtimes = {finding["device"].split()[0] for finding in findings}
    assert {"ai-edge-litert", "onnxruntime", "openvino"} <= runtimes


def test_check_finds_a_changed_and_a_missing_file(overflight: Overflight, tiny: Path) -> None:
    assert add(overflight, "tiny.tflite", "tiny.onnx").code == 0
    write_tflite(tiny / "tiny.tflite", operators=2)
    (tiny / "tiny.onnx").unlink()
    answer = overflight("models", "check", "tiny", "--models", "models.yaml")
    assert answer.code == 1
    assert f"{tiny / 'tiny.tflite'} has sha256" in answer.err
    assert "no file tiny.onnx" in answer.err
    findings = json.loads(
        overflight("models", "check", "tiny", "--models", "models.yaml", "--json").out
    )
    assert [finding["state"] for finding in findings] == ["wrong", "missing"]


def test_check_of_an_unknown_model_is_a_users_mistake(overflight: Overflight) -> None:
    answer = overflight("models", "check", "segment-rbg")
    assert answer.code == 2
    assert "did you mean 'segment-rgb'?" in answer.err


def test_added_files_become_variants_with_what_their_files_say(
    overflight: Overflight, tiny: Path
) -> None:
    answer = add(overflight, "tiny.tflite", "tiny.onnx", "--license", "MIT", "--source", "mine")
    assert answer.out.splitlines()[0] == "models.yaml: added tiny"
    assert "assumed: the order of the channels is rgb (--color)" in answer.out
    assert "license" not in answer.out
    entry = yaml.safe_load((tiny / "models.yaml").read_text())["models"]["tiny"]
    assert entry["input"] == {"shape": [2, 3, 3], "dtype": "uint8", "color": "rgb"}
    assert entry["head"]["class_map"] == {0: "road", 1: "building", 2: "vehicle"}
    assert [one["kind"] for one in entry["variants"]] == ["tflite", "onnx"]
    assert entry["variants"][0]["outputs"] == {
        "scores": {"name": "y1", "shape": [1, 2, 3, 3], "dtype": "float32"}
    }


def test_adding_leaves_the_rest_of_the_file_as_it_is(overflight: Overflight, tiny: Path) -> None:
    before = "# Mine.\nroots: [.]  # here\n\nmodels:\n  # The first.\n"
    (tiny / "models.yaml").write_text("# Mine.\nroots: [.]  # here\n")
    assert add(overflight, "tiny.tflite").code == 0
    text = (tiny / "models.yaml").read_text().replace("models:\n", "models:\n  # The first.\n")
    (tiny / "models.yaml").write_text(text)
    answer = overflight(
        *("models", "add", "tiny.onnx", "--name", "other", "--head", "scores", "--color", "bgr")
    )
    assert answer.code == 0, answer.err
    after = (tiny / "models.yaml").read_text()
    assert after.startswith(before)
    assert after.startswith(text.rstrip("\n"))
    assert list(yaml.safe_load(after)["models"]) == ["tiny", "other"]


def test_a_name_that_is_there_is_only_replaced_on_request(
    overflight: Overflight, tiny: Path
) -> None:
    assert add(overflight, "tiny.tflite").code == 0
    text = (tiny / "models.yaml").read_text()
    answer = add(overflight, "tiny.onnx")
    assert answer.code == 2
    assert answer.err == "models.yaml: has a model 'tiny' already; --replace rewrites it\n"
    assert (tiny / "models.yaml").read_text() == text
    assert add(overflight, "tiny.onnx", "--replace").out.startswith("models.yaml: replaced tiny")
    (variant,) = yaml.safe_load((tiny / "models.yaml").read_text())["models"]["tiny"]["variants"]
    assert variant["kind"] == "onnx"


def test_the_name_of_a_shipped_model_is_only_taken_on_request(
    overflight: Overflight, tiny: Path
) -> None:
    words = ("models", "add", "tiny.onnx", "--name", "segment-rgb", "--head", "scores")
    answer = overflight(*words)
    assert answer.code == 2
    assert "'segment-rgb' ships with Overflight" in answer.err
    assert overflight(*words, "--replace").code == 0


def test_an_openvino_model_needs_its_weights_beside_it(overflight: Overflight, tiny: Path) -> None:
    write_openvino(tiny / "tiny.xml")
    answer = add(overflight, "tiny.xml")
    assert (answer.code, answer.err) == (
        2,
        "tiny.bin: no such file; it holds the weights of tiny.xml\n",
    )
    (tiny / "tiny.bin").touch()
    assert add(overflight, "tiny.xml").code == 0


def test_a_tflite_may_be_cut_at_a_tensor_by_name(overflight: Overflight, tiny: Path) -> None:
    write_tflite(tiny / "chain.tflite", operators=3)
    assert add(overflight, "chain.tflite", "--output", "scores=y2").code == 0
    entry = yaml.safe_load((tiny / "models.yaml").read_text())["models"]["tiny"]
    output = entry["variants"][0]["outputs"]["scores"]
    assert (output["tensor"], output["name"]) == (2, "y2")
    assert overflight("models", "check", "tiny", "--models", "models.yaml").code == 0


SCORES = ("tiny.tflite", "--head", "scores")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("tiny.tflite", "--head", "scroes"), "no kind of head 'scroes'; did you mean 'scores'?"),
        ((*SCORES, "--classes", "0=rod"), "no class 'rod'; did you mean 'road'?"),
        ((*SCORES, "--classes", "cityscape"), "no label set 'cityscape'; did you mean"),
        ((*SCORES, "--classes", "x=road"), "classes look like 0=road,1=sidewalk"),
        (("tiny.tflite", "--head", "ssd"), "has y1; a head of kind 'ssd' needs boxes, scores"),
        (("tiny.tflite",), "does not say what its outputs mean; give --head, one of scores,"),
        (("gone.tflite", "--head", "scores"), "gone.tflite: cannot be read (No such file"),
        (("tiny.txt", "--head", "scores"), "tiny.txt: is none of the model files known here"),
        ((*SCORES, "--color", "rbg"), "none of rgb, bgr and gray"),
        ((*SCORES, "--output", "scores"), "looks like boxes=concat"),
        ((*SCORES, "--registry", "broken.yaml"), "broken.yaml: is not YAML"),
        ((*SCORES, "--registry", "flow.yaml"), "is written in braces"),
    ],
)
def test_what_cannot_be_added_says_why_and_changes_nothing(
    overflight: Overflight, tiny: Path, words: tuple[str, ...], said: str
) -> None:
    (tiny / "tiny.txt").write_text("no model")
    (tiny / "broken.yaml").write_text("models: [1")
    other = "{description: x, license: x, source: x, input: {shape: [1, 1, 1]}, head: {kind: x}"
    (tiny / "flow.yaml").write_text(f"models: {{a: {other}, variants: [{{kind: emulated}}]}}}}")
    before = {path: path.read_bytes() for path in tiny.iterdir()}
    answer = overflight("models", "add", *words, "--name", "tiny", "--json")
    assert answer.code == 2
    assert said in " ".join(answer.err.replace("│", " ").split())
    assert {path: path.read_bytes() for path in tiny.iterdir()} == before


def test_check_edgetpu_tells_the_cut(overflight: Overflight, shared: Path) -> None:
    path = shared / "models" / "coral" / COMPILED.replace("_edgetpu", "")
    answer = overflight("models", "check-edgetpu", path)
    assert answer.code == 0
    assert "would run 64 of 72 operations" in answer.out
    assert "Cut at operation 64, RESIZE_BILINEAR 'ResizeBilinear': it enlarges 33" in answer.out
    page = json.loads(overflight("models", "check-edgetpu", path, "--json").out)
    assert (page["mapped"], page["operations"], len(page["on_cpu"])) == (64, 72, 8)
    assert page["on_cpu"][0]["cuts"]
    answer = overflight("models", "check-edgetpu", path.with_name(COMPILED))
    assert (answer.code, answer.out) == (2, "")
    assert "already compiled" in answer.err


GRAPH = """\
overflight: 1
graph: swap
devices:
  edgetpu: {use: accelerators.litert:EdgeTpu}
  cpu: {use: accelerators.litert:TfliteCpu}
  ort: {use: accelerators.onnx:Onnx}
  igpu: {use: accelerators.openvino:OpenVino}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 12, height: 8}}
  segment:
    use: stages.segment_image:SegmentImage
    executor: [cpu]
    model: tiny
    inputs: {image: camera}
  count: {use: stages.sinks.count:Count, inputs: {message: segment}}
"""


@pytest.fixture
def graph(tiny: Path, overflight: Overflight) -> Callable[..., Any]:
    """Validate or run the graph with another executor."""
    (tiny / "swap.yaml").write_text(GRAPH)
    assert add(overflight, "tiny.tflite", "tiny.onnx").code == 0

    def with_executor(verb: str, executor: str, *words: str) -> Any:
        setting = ("--set", f"stages.segment.executor={executor}")
        return overflight(verb, "swap.yaml", "--models", "models.yaml", *setting, *words)

    return with_executor


@pytest.mark.parametrize("executor", ["cpu", "igpu", "ort", "[igpu, cpu]"])
def test_a_swap_is_one_line_whether_a_name_or_a_list(graph: Overflight, executor: str) -> None:
    assert graph("validate", executor).code == 0
    words = ("--speed", "max", "--duration", "0.2", "--json")
    report = json.loads(graph("run", executor, *words).out)
    assert report["ledger_balanced"]
    assert report["stages"]["segment"]["runs"] > 0
    first = executor.strip("[]").split(",")[0]
    assert report["devices"][first]["runs"] == report["stages"]["segment"]["runs"]


NOT_THERE = (
    "--set stages.segment.executor: 'edgetpu': model 'tiny' has no variant for EdgeTpu, "
    "which runs edgetpu; it has tflite, onnx. Name another device, or add such a file with "
    "'overflight models add'"
)


def test_a_model_without_a_variant_for_the_device_is_found_by_validate(graph: Overflight) -> None:
    answer = graph("validate", "edgetpu")
    assert answer.code == 2
    assert answer.err.splitlines()[0] == NOT_THERE


def test_a_file_of_another_sum_is_found_by_validate(graph: Overflight, tiny: Path) -> None:
    write_tflite(tiny / "tiny.tflite", operators=2)
    answer = graph("validate", "cpu")
    assert answer.code == 2
    assert f"{tiny / 'tiny.tflite'} has sha256 " in answer.err
    assert "fetch the file again, or enter the new sum if the change is yours" in answer.err
    assert graph("validate", "ort").code == 0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "shape: [1, 2, 3, 3]",
            "shape: [1, 4, 4, 3]",
            "output 'scores' has shape (1, 2, 3, 3) in the file, (1, 4, 4, 3) in the registry",
        ),
        (
            "dtype: float32",
            "dtype: uint8",
            "output 'scores' has dtype float32 in the file, uint8 in the registry",
        ),
        (
            "shape: [2, 3, 3]",
            "shape: [4, 4, 3]",
            "the file's input is (1, 2, 3, 3), the registry says (n, 4, 4, 3)",
        ),
        ("name: y1", "name: y7", "output 'scores' is named 'y7' in the registry; the file has y1"),
    ],
)
def test_a_file_that_differs_from_its_entry_is_found_by_validate(
    graph: Overflight, tiny: Path, old: str, new: str, said: str
) -> None:
    registry = tiny / "models.yaml"
    assert old in registry.read_text()
    registry.write_text(registry.read_text().replace(old, new))
    answer = graph("validate", "cpu")
    assert answer.code == 2
    assert answer.err.startswith(f"--set stages.segment.executor: 'cpu': model 'tiny': {said}")


def test_a_compiled_file_on_a_cpu_is_found_by_validate(
    graph: Overflight, tiny: Path, shared: Path
) -> None:
    compiled = (shared / "models" / "coral" / COMPILED).resolve()  # as the message shows it
    registry = tiny / "models.yaml"
    lines = registry.read_text().splitlines()
    number = next(n for n, line in enumerate(lines) if "file: tiny.tflite" in line)
    lines[number : number + 2] = [lines[number].replace("tiny.tflite", str(compiled))]
    registry.write_text("\n".join(lines))
    answer = graph("validate", "cpu")
    assert answer.code == 2
    assert answer.err.splitlines()[0] == (
        f"--set stages.segment.executor: 'cpu': model 'tiny': {compiled} is compiled for "
        "the Edge TPU and runs nowhere else; make its kind 'edgetpu', and name the .tflite that it "
        "was compiled from for the other devices"
    )
