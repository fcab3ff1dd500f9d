from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tiny_models import write_onnx, write_tflite

from accelerators.emulated import Emulated
from accelerators.fitting import output_forms
from accelerators.litert import TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.registry import Registry
from accelerators.registry_file import SHIPPED, OutputEntry, VariantEntry
from accelerators.tensors import BoundFile, InputForm
from pipeline.errors import ModelError
from pipeline.model import Native, Tensor, TensorSpec

ENTRY = """
models:
  tiny:
    description: relu
    license: Apache-2.0
    source: the tests
    input: {{name: x, shape: [2, 3, 3], dtype: float32}}
    head: {{kind: none, answer: 42}}
    variants:
      - {variant}
"""


def registry(tmp_path: Path, variant: str) -> Registry:
    path = tmp_path / "mine.yaml"
    path.write_text(ENTRY.format(variant=variant))
    return Registry.open(path)


def test_the_shipped_registry_reads_and_runs_on_emulated_devices() -> None:
    models = Registry.open()
    for name in ("segment-rgb", "detect-rgb", "detect-thermal", "segment-scan"):
        device = Emulated(latency_ms={name: 0.0})
        assert models.check(name, device) is None
        model = models.load(name, device)
        spec = model.spec
        zeros = np.zeros((1, *spec.input_shape), spec.input_dtype)
        found = model.decode(model.infer(model.encode({spec.input_name: Tensor(zeros)})))
        assert all(len(tensor.array) == 1 for tensor in found.values())


def test_the_shipped_sums_are_those_of_the_manifest(shared: Path) -> None:
    with (shared / "models" / "MANIFEST.tsv").open() as file:
        sums = {row["file"]: row["sha256"] for row in csv.DictReader(file, delimiter="\t")}
    models = Registry.open()
    for name in models.names():
        for variant in models.entry(name).variants:
            if not variant.file or (SHIPPED.parent / variant.file).is_file():
                continue  # those that lie beside the registry are ours, not the manifest's
            assert variant.sha256 == sums[variant.file]
            if variant.weights:
                assert variant.weights_sha256 == sums[variant.weights]


def test_every_shipped_file_loads_on_every_device_of_its_kind(shared: Path) -> None:
    models = Registry.open()
    loaded = []
    for device in (TfliteCpu(), OpenVino(), Onnx()):
        for name in models.names():
            if models.check(name, device) is None:
                models.load(name, device)
                loaded.append((name, type(device).__name__))
    assert len(loaded) == 19


def test_a_users_file_adds_a_model_that_loads_from_beside_it(tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    sha256 = hashlib.sha256((tmp_path / "tiny.tflite").read_bytes()).hexdigest()
    models = registry(
        tmp_path, f"{{kind: tflite, file: tiny.tflite, sha256: {sha256}, outputs: {{y: {{}}}}}}"
    )
    model = models.load("tiny", TfliteCpu())
    x = np.random.default_rng(0).normal(size=(1, 2, 3, 3)).astype(np.float32)
    found = model.decode(model.infer(model.encode({"x": Tensor(x)})))
    np.testing.assert_array_equal(found["y"].array, np.maximum(x, 0))
    assert model.spec.head == {"kind": "none", "class_map": {}, "answer": 42}
    assert "segment-rgb" in models.names()


def test_a_device_takes_the_variant_it_runs_best(tmp_path: Path) -> None:
    write_onnx(tmp_path / "tiny.onnx")
    variants = "{kind: emulated, outputs: {y: {shape: [1]}}}\n      - {kind: onnx, file: tiny.onnx}"
    models = registry(tmp_path, variants)
    for device in (Onnx(), OpenVino()):
        assert models.check("tiny", device) is None
    said = models.check("tiny", TfliteCpu())
    assert said == (
        "model 'tiny' has no variant for TfliteCpu, which runs tflite; it has emulated, onnx. "
        "Name another device, or add such a file with 'overflight models add'"
    )


def test_a_model_with_an_8_bit_file_alone_can_be_converted(tmp_path: Path) -> None:
    models = registry(tmp_path, "{kind: tflite, file: tiny.tflite}")
    for device in (Onnx(), OpenVino()):
        said = models.check("tiny", device)
        assert said is not None
        assert "make an .onnx with 'overflight models convert tiny'" in said


def test_a_missing_file_is_named_with_where_it_was_looked_for(tmp_path: Path) -> None:
    models = registry(tmp_path, "{kind: tflite, file: gone.tflite}")
    said = models.check("tiny", TfliteCpu())
    assert said is not None
    assert said.startswith("model 'tiny': no file gone.tflite in ")
    assert str(tmp_path) in said
    assert "source: the tests" in said


def test_a_later_file_may_only_name_a_folder(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    write_tflite(tmp_path / "files" / "tiny.tflite")
    registry(tmp_path, "{kind: tflite, file: tiny.tflite}")
    (tmp_path / "roots.yaml").write_text("roots: [files]\n")
    models = Registry.open(tmp_path / "mine.yaml", tmp_path / "roots.yaml")
    assert models.check("tiny", TfliteCpu()) is None


def test_a_changed_file_is_refused_with_both_sums(tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    models = registry(tmp_path, f"{{kind: tflite, file: tiny.tflite, sha256: {'a' * 64}}}")
    path = tmp_path / "tiny.tflite"
    said = (
        f"model 'tiny': {path} has sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}, the "
        f"registry says {'a' * 64}; fetch the file again, or enter the new sum if the change is "
        "yours"
    )
    assert models.check("tiny", TfliteCpu()) == said
    with pytest.raises(ModelError, match=re.escape(said)):
        models.load("tiny", TfliteCpu())


def test_an_unknown_model_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(ModelError, match="no model 'segment-rbg'; did you mean 'segment-rgb'"):
        Registry.open().spec("segment-rbg")


TINY = "kind: tflite, file: tiny.tflite"
CORRECT = "correct the entry, or name the file that it describes"


@pytest.mark.parametrize(
    ("variant", "said"),
    [
        (
            f"{TINY}, outputs: {{y: {{name: z}}}}",
            "output 'y' is named 'z' in the registry; the file has y1",
        ),
        (
            f"{TINY}, outputs: {{y: {{shape: [1, 9]}}}}",
            f"output 'y' has shape (1, 2, 3, 3) in the file, (1, 9) in the registry; {CORRECT}",
        ),
        (
            f"{TINY}, outputs: {{y: {{dtype: uint8}}}}",
            f"output 'y' has dtype float32 in the file, uint8 in the registry; {CORRECT}",
        ),
        (
            f"{TINY}, outputs: {{y: {{scale: 0.5}}}}",
            f"output 'y' has scale 0.0 in the file, 0.5 in the registry; {CORRECT}",
        ),
        (
            f"{TINY}, layout: nchw",
            "the file's input is (1, 2, 3, 3), the registry says (n, 3, 2, 3); correct its 'input' "
            "or the variant's 'layout'",
        ),
        (
            f"{TINY}, constants: {{x: 0}}",
            "the file has the inputs none; it must have one, an image",
        ),
    ],
)
def test_a_file_that_differs_from_its_entry_is_refused_before_and_when_it_is_loaded(
    tmp_path: Path, variant: str, said: str
) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    models = registry(tmp_path, f"{{{variant}}}")
    assert models.check("tiny", TfliteCpu()) == f"model 'tiny': {said}"
    with pytest.raises(ModelError, match=re.escape(said)):
        models.load("tiny", TfliteCpu())


def test_a_file_of_another_kind_than_its_entry_is_refused_with_its_own_kind(tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    models = registry(tmp_path, "{kind: onnx, file: tiny.tflite}")
    path = tmp_path / "tiny.tflite"
    assert models.check("tiny", Onnx()) == (
        f"model 'tiny': {path} is TensorFlow Lite and not compiled for the Edge TPU; make its kind "
        "'tflite', or compile it with edgetpu_compiler"
    )


def test_a_cut_that_the_file_does_not_have_is_named(tmp_path: Path) -> None:
    path = tmp_path / "tiny.tflite"
    write_tflite(path)
    cut = "{kind: tflite, file: tiny.tflite, outputs: {y: {tensor: 210, name: y9}}}"
    said = registry(tmp_path, cut).check("tiny", TfliteCpu())
    assert said is not None
    assert said.startswith(f"{path}: ")
    assert "it has 2 tensors, and none of number 210" in said
    write_tflite(path, compiled=1)  # of another kind: that is what is wrong with it
    said = registry(tmp_path, cut).check("tiny", TfliteCpu())
    assert said is not None
    assert "is compiled for the Edge TPU and runs nowhere else" in said


def test_a_compiled_file_under_a_cpu_is_refused_with_the_way_out(
    tmp_path: Path, shared: Path
) -> None:
    file = "deeplabv3_mnv2_dm05_pascal_quant_edgetpu.tflite"
    path = (shared / "models" / "coral" / file).resolve()  # as the message shows it
    models = registry(tmp_path, f"{{kind: tflite, file: {path}}}")
    assert models.check("tiny", TfliteCpu()) == (
        f"model 'tiny': {path} is compiled for the Edge TPU and runs nowhere else; make its kind "
        "'edgetpu', and name the .tflite that it was compiled from for the other devices"
    )


def test_a_damaged_file_is_found_before_it_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "tiny.tflite").write_bytes(b"\x1c\0\0\0TFL3")
    said = registry(tmp_path, f"{{{TINY}}}").check("tiny", TfliteCpu())
    assert said is not None
    assert "tiny.tflite: cannot be read as a model" in said


def test_an_output_whose_file_does_not_state_its_quantization_has_that_of_the_entry(
    tmp_path: Path,
) -> None:
    spec = TensorSpec((1, 2, 3, 3), "uint8")
    entry = VariantEntry(kind="onnx", outputs={"y": OutputEntry(scale=0.5, zero_point=3)})
    model = NoComputing({"x": TensorSpec((1, 2, 3, 3), "float32")}, {"y1": spec})
    bound = BoundFile(
        registry(tmp_path, "{kind: onnx}").spec("tiny"),
        model,
        InputForm(),
        output_forms("tiny", entry, model.outputs),
    )
    stored = np.full(spec.shape, 5, np.uint8)
    (found,) = bound.decode({"y1": stored}).values()
    np.testing.assert_array_equal(found.values(), np.ones(spec.shape))


@dataclass
class NoComputing:
    """A model of these inputs and outputs."""

    inputs: Mapping[str, TensorSpec]
    outputs: Mapping[str, TensorSpec]

    def infer(self, inputs: Native) -> Native:
        raise NotImplementedError


def test_the_variant_to_load_may_be_named(tmp_path: Path) -> None:
    write_onnx(tmp_path / "a.onnx")
    write_onnx(tmp_path / "b.onnx")
    models = registry(tmp_path, "{kind: onnx, file: a.onnx}\n      - {kind: onnx, file: b.onnx}")
    (tmp_path / "a.onnx").unlink()
    with pytest.raises(ModelError, match=r"no file a\.onnx"):
        models.load("tiny", Onnx())
    models.load("tiny", Onnx(), models.entry("tiny").variants[1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("models: {a: {description: x}}", "mine.yaml: models.a.license: Field required"),
        ("modles: {}", "mine.yaml: modles: Extra inputs are not permitted"),
        ("a: [1", "mine.yaml: is not YAML"),
        ("- 1", "mine.yaml: the file: "),
    ],
)
def test_a_wrong_file_is_answered_with_the_place(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ModelError, match=said):
        Registry.open(path)


def test_a_registry_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.yaml: cannot be read"):
        Registry.open(tmp_path / "none.yaml")


def test_of_two_files_of_one_name_the_one_of_the_sum_is_meant(tmp_path: Path) -> None:
    write_tflite(tmp_path / "detect-thermal_int8.tflite")  # such a file ships, too
    sha256 = hashlib.sha256((tmp_path / "detect-thermal_int8.tflite").read_bytes()).hexdigest()
    models = registry(
        tmp_path,
        "{kind: tflite, file: detect-thermal_int8.tflite, "
        f"sha256: {sha256}, outputs: {{y: {{}}}}}}",
    )
    path, _ = models.files("tiny", models.variant("tiny", TfliteCpu()))
    assert path == tmp_path / "detect-thermal_int8.tflite"
    models.load("detect-thermal", TfliteCpu())
