from __future__ import annotations

from pathlib import Path

import pytest
from tiny_models import write_openvino

from accelerators.openvino import OpenVino
from pipeline.errors import DeviceError


@pytest.mark.parametrize("device", ["AUTO", "AUTO:GPU,CPU", "MULTI:CPU", "HETERO:GPU,CPU"])
def test_a_device_that_picks_by_itself_is_a_bad_option(device: str) -> None:
    with pytest.raises(ValueError, match="picks by itself; name one device"):
        OpenVino(device=device)


def test_a_device_that_is_not_there_is_never_replaced_by_the_cpu(tmp_path: Path) -> None:
    gpu = OpenVino(device="GPU")
    if gpu.probe().available:
        pytest.skip("this machine has an OpenVINO GPU")
    assert "no device GPU, only CPU" in gpu.probe().reason
    write_openvino(tmp_path / "tiny.xml")
    with pytest.raises(DeviceError, match="on GPU"):
        gpu.load(str(tmp_path / "tiny.xml"), {})


def test_models_are_compiled_with_the_precision_and_threads_of_the_graph(tmp_path: Path) -> None:
    write_openvino(tmp_path / "tiny.xml")
    device = OpenVino(threads=2)
    model = device.load(str(tmp_path / "tiny.xml"), {})
    compiled = model._request.get_compiled_model()  # type: ignore[attr-defined]
    assert compiled.get_property("INFERENCE_PRECISION_HINT").to_string() == "f32"
    assert compiled.get_property("INFERENCE_NUM_THREADS") == 2
    assert compiled.get_property("ENABLE_CPU_PINNING") is False
