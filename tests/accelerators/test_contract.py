"""The contract of `pipeline.model.Accelerator`, over every accelerator that this machine has."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from stub_edgetpu import stub_library
from tiny_models import SHAPE, write_edgetpu, write_onnx, write_openvino, write_tflite

import accelerators
from accelerators.emulated import Emulated
from accelerators.litert import EdgeTpu, TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino
from accelerators.recorded import Record, Recorded
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Accelerator, Model


@dataclass(frozen=True)
class Case:
    """An accelerator, the file it takes, and whether it computes."""

    make: Callable[[], Accelerator]
    suffix: str
    write: Callable[[Path], None] | None

    @property
    def computes(self) -> bool:
        return self.write is not None


ANSWERS = TemporaryDirectory(prefix="answers_")  #: gone with the tests

CASES = {
    "litert": Case(lambda: TfliteCpu(tflite_backend="litert"), ".tflite", write_tflite),
    "tflite_runtime": Case(
        lambda: TfliteCpu(tflite_backend="tflite_runtime"), ".tflite", write_tflite
    ),
    "edgetpu_litert": Case(
        lambda: EdgeTpu(library=stub_library(), tflite_backend="litert"), ".tflite", write_edgetpu
    ),
    "edgetpu_tflite_runtime": Case(
        lambda: EdgeTpu(library=stub_library(), tflite_backend="tflite_runtime"),
        ".tflite",
        write_edgetpu,
    ),
    "openvino_cpu": Case(OpenVino, ".xml", write_openvino),
    "openvino_gpu": Case(lambda: OpenVino(device="GPU"), ".xml", write_openvino),
    "openvino_onnx": Case(OpenVino, ".onnx", write_onnx),
    "onnx": Case(Onnx, ".onnx", write_onnx),
    "emulated": Case(lambda: Emulated(latency_ms={"tiny": 0.1}), "", None),
    "record": Case(lambda: Record(device=Onnx(), path=Path(ANSWERS.name)), ".onnx", write_onnx),
    "emulated_with_real_outputs": Case(
        lambda: Emulated(latency_ms={"tiny": 0.1}, outputs=Onnx()), ".onnx", write_onnx
    ),
}

VARIANT: Mapping[str, Any] = {
    "model": "tiny",
    "kind": "the one of the file",
    "input": {"name": "x", "shape": SHAPE[1:], "dtype": "float32"},
    "outputs": {"y1": {"shape": SHAPE}},
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    case = CASES[request.param]
    probe = case.make().probe()
    if not probe.available:
        pytest.skip(probe.reason)
    return case


@pytest.fixture
def model(case: Case, tmp_path: Path) -> Model:
    path = tmp_path / f"tiny{case.suffix}"
    if case.write:
        case.write(path)
    return case.make().load(str(path), VARIANT)


def test_every_accelerator_that_ships_has_a_case() -> None:
    shipped = {
        cls
        for module in pkgutil.iter_modules(accelerators.__path__, "accelerators.")
        for cls in vars(importlib.import_module(module.name)).values()
        if isinstance(cls, type) and hasattr(cls, "kinds") and cls.__module__ == module.name
    }
    missing = shipped - {type(case.make()) for case in CASES.values()}
    assert missing == {Recorded}, "it alone computes nothing that it was not told before"


def test_a_probe_names_the_device_and_the_runtime_with_its_version(case: Case) -> None:
    probe = case.make().probe()
    assert probe.name
    assert probe.runtime
    assert probe.reason == ""


def test_a_model_states_the_shape_and_dtype_of_its_tensors(model: Model) -> None:
    assert [(one.shape, one.dtype) for one in model.inputs.values()] == [(SHAPE, "float32")]
    assert [(one.shape, one.dtype) for one in model.outputs.values()] == [(SHAPE, "float32")]


def test_infer_computes_the_network(case: Case, model: Model) -> None:
    if not case.computes:
        pytest.skip("an emulated device computes nothing")
    x = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
    found = model.infer({next(iter(model.inputs)): x})
    np.testing.assert_allclose(found[next(iter(model.outputs))], np.maximum(x, 0), rtol=1e-6)


@pytest.mark.parametrize("form", ["read-only", "not contiguous"])
def test_an_input_may_be_any_array_of_its_shape(case: Case, model: Model, form: str) -> None:
    """Payloads are shared read-only, and a stage may hand in a view."""
    x = np.arange(18, dtype=np.float32).reshape(SHAPE) - 9
    given = x.copy()
    if form == "read-only":
        given.flags.writeable = False
    else:
        given = given[..., ::-1].copy()[..., ::-1]
    (name,), (out,) = model.inputs, model.outputs
    found = model.infer({name: given})[out]
    np.testing.assert_array_equal(found, np.maximum(x, 0) if case.computes else found)
    np.testing.assert_array_equal(given, x)


def test_results_belong_to_the_caller(model: Model) -> None:
    (name,), (out,) = model.inputs, model.outputs
    first = model.infer({name: np.full(SHAPE, 1, np.float32)})[out]
    kept = first.copy()
    model.infer({name: np.full(SHAPE, 2, np.float32)})
    np.testing.assert_array_equal(first, kept)


def test_a_model_may_be_used_on_another_thread_than_it_was_loaded_on(model: Model) -> None:
    (name,) = model.inputs
    x = np.full(SHAPE, -1, np.float32)
    with ThreadPoolExecutor(1) as pool:
        (found,) = pool.submit(model.infer, {name: x}).result(timeout=60).values()
    assert not found.any()


def test_two_models_on_one_device_do_not_mix(case: Case, tmp_path: Path) -> None:
    path = tmp_path / f"tiny{case.suffix}"
    if case.write:
        case.write(path)
    device = case.make()
    one, two = device.load(str(path), VARIANT), device.load(str(path), VARIANT)
    (name,), (out,) = one.inputs, one.outputs
    a = one.infer({name: np.full(SHAPE, 1, np.float32)})[out].copy()
    b = two.infer({name: np.full(SHAPE, 3, np.float32)})[out]
    assert not case.computes or (a.max(), b.max()) == (1, 3)
    assert a.shape == b.shape == SHAPE
    device.close()


@pytest.mark.parametrize(
    "wrong",
    [np.zeros((1, 2, 3, 4), np.float32), np.zeros(SHAPE, np.float64), np.zeros(SHAPE, np.uint8)],
    ids=["shape", "float64", "uint8"],
)
def test_an_input_that_does_not_fit_is_a_device_error(model: Model, wrong: Any) -> None:
    (name,) = model.inputs
    with pytest.raises(DeviceError):
        model.infer({name: wrong})


def test_a_missing_file_is_named(case: Case, tmp_path: Path) -> None:
    if not case.computes:
        pytest.skip("an emulated device reads no file")
    path = tmp_path / f"nothing{case.suffix}"
    with pytest.raises(ModelError, match=path.name):
        case.make().load(str(path), VARIANT)


def test_a_file_of_garbage_is_named(case: Case, tmp_path: Path) -> None:
    if not case.computes:
        pytest.skip("an emulated device reads no file")
    path = tmp_path / f"garbage{case.suffix}"
    path.write_bytes(b"no model at all" * 10)
    with pytest.raises(ModelError, match=path.name):
        case.make().load(str(path), VARIANT)


def test_close_may_be_called_twice_and_before_anything_was_loaded(case: Case) -> None:
    device = case.make()
    device.close()
    device.close()


@pytest.mark.parametrize("make", [TfliteCpu, EdgeTpu, OpenVino, Onnx])
def test_no_threads_is_a_bad_option(make: Callable[..., Accelerator]) -> None:
    with pytest.raises(ValueError, match="threads must be at least 1"):
        make(threads=0)
