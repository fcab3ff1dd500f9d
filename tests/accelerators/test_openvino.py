from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_models import SHAPE, write_onnx, write_openvino

from accelerators.openvino import OpenVino
from pipeline.errors import DeviceError
from pipeline.model import Model


@pytest.fixture
def tiny(tmp_path: Path) -> str:
    write_openvino(tmp_path / "tiny.xml")
    return str(tmp_path / "tiny.xml")


def compiled(model: Model) -> Any:
    return model._request.get_compiled_model()  # type: ignore[attr-defined]


class Core:
    """OpenVINO on a machine that is not here."""

    def __init__(self, devices: Sequence[str], capabilities: Sequence[str] = ("FP32",)) -> None:
        self.available_devices = list(devices)
        self._properties = {
            "FULL_DEVICE_NAME": "Intel(R) Graphics (iGPU) ",
            "OPTIMIZATION_CAPABILITIES": list(capabilities),
            "GPU_DRIVER_VERSION": "26.05.1",
        }

    def get_property(self, device: str, name: str) -> Any:
        return self._properties[name]


def on(core: Core, **options: Any) -> OpenVino:
    device = OpenVino(**options)
    device._core = core
    return device


@pytest.mark.parametrize("device", ["AUTO", "AUTO:GPU,CPU", "MULTI:CPU", "HETERO:GPU,CPU"])
def test_a_device_that_picks_by_itself_is_a_bad_option(device: str) -> None:
    with pytest.raises(ValueError, match="picks by itself; name one device"):
        OpenVino(device=device)


@pytest.mark.parametrize("device", ["gpu", "", "GPU:0", "GPU.", "cpu"])
def test_a_device_of_no_known_form_is_a_bad_option(device: str) -> None:
    with pytest.raises(ValueError, match="is no OpenVINO device; write CPU"):
        OpenVino(device=device)


@pytest.mark.parametrize("device", ["GPU", "GPU.0", "NPU"])
def test_a_device_that_is_not_there_is_never_replaced_by_the_cpu(device: str, tiny: str) -> None:
    there = OpenVino(device=device)
    if there.probe().available:
        pytest.skip(f"this machine has an OpenVINO {device}")
    assert f"no device {device}, only CPU" in there.probe().reason
    with pytest.raises(DeviceError, match=f"on {device}: OpenVINO finds no device {device}"):
        there.load(tiny, {})


@pytest.mark.parametrize(
    ("asked", "listed", "there"),
    [
        ("GPU", ["CPU", "GPU"], True),
        ("GPU.0", ["CPU", "GPU"], True),  # a lone GPU is listed without a number
        ("GPU", ["CPU", "GPU.0", "GPU.1"], True),
        ("GPU.1", ["CPU", "GPU.0", "GPU.1"], True),
        ("GPU.1", ["CPU", "GPU"], False),
        ("NPU", ["CPU", "GPU"], False),
    ],
)
def test_a_gpu_is_found_by_its_number(asked: str, listed: list[str], there: bool) -> None:
    probe = on(Core(listed), device=asked).probe()
    assert probe.available is there
    if there:
        assert (probe.name, probe.driver) == ("Intel(R) Graphics (iGPU)", "26.05.1")


def test_a_precision_that_the_device_does_not_have_is_refused_not_replaced(tiny: str) -> None:
    device = on(Core(["GPU"], ["FP32", "FP16", "INT8"]), device="GPU", precision="bf16")
    assert device.probe().reason == (
        "Intel(R) Graphics (iGPU) does not compute in bf16; set precision to f32, f16"
    )
    with pytest.raises(DeviceError, match="does not compute in bf16"):
        device.load(tiny, {})


def test_models_are_compiled_with_the_precision_and_threads_of_the_graph(tiny: str) -> None:
    model = compiled(OpenVino(threads=2).load(tiny, {}))
    assert model.get_property("INFERENCE_PRECISION_HINT").to_string() == "f32"
    assert model.get_property("INFERENCE_NUM_THREADS") == min(2, len(os.sched_getaffinity(0)))
    assert model.get_property("ENABLE_CPU_PINNING") is False
    assert model.get_property("EXECUTION_DEVICES") == ["CPU"]


def test_without_our_default_openvino_would_compute_in_bfloat16(tiny: str) -> None:
    """The trap that `precision: f32` avoids; it goes away where the CPU has no bfloat16.

    In a process of its own: bfloat16 turns the AMX unit on, whose state does not fit the signal
    stack that a test process may have, and the next signal would kill it.
    """
    script = """
import sys, openvino
from accelerators.openvino import OpenVino
core = openvino.Core()
if "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
    default = core.compile_model(sys.argv[1], "CPU")
    model = OpenVino(precision="bf16").load(sys.argv[1], {})
    ours = model._request.get_compiled_model()
    print(*(m.get_property("INFERENCE_PRECISION_HINT").to_string() for m in (default, ours)))
"""
    words = [sys.executable, "-c", script, tiny]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    if not said:
        pytest.skip("this CPU does not compute in bfloat16")
    assert said.split() == ["bf16", "bf16"]


def test_a_model_from_the_cache_keeps_its_precision(tiny: str, tmp_path: Path) -> None:
    device = OpenVino(cache_dir=tmp_path / "cache")
    x = np.linspace(-1, 1, 18, dtype=np.float32).reshape(SHAPE)
    first = device.load(tiny, {})
    again = device.load(tiny, {})
    assert any((tmp_path / "cache").iterdir())
    assert compiled(again).get_property("LOADED_FROM_CACHE")
    assert compiled(again).get_property("INFERENCE_PRECISION_HINT").to_string() == "f32"
    np.testing.assert_array_equal(first.infer({"x": x})["y1"], again.infer({"x": x})["y1"])


def test_an_input_is_never_cast(tmp_path: Path) -> None:
    write_onnx(tmp_path / "tiny.onnx")
    model = OpenVino().load(str(tmp_path / "tiny.onnx"), {})
    for dtype in (np.float64, np.uint8, np.float16):
        with pytest.raises(DeviceError, match=f"'x' takes float32, not {np.dtype(dtype).name}"):
            model.infer({"x": np.zeros(SHAPE, dtype)})


def test_tensorflow_lite_files_are_left_to_the_runtime_that_reads_all_of_them() -> None:
    assert "tflite" not in OpenVino.kinds


def test_the_devices_worth_a_try_are_those_found_and_the_gpu() -> None:
    names = [candidate["device"] for candidate in OpenVino.candidates()]
    assert names[0] == "CPU"
    assert any(name.startswith("GPU") for name in names)
