from __future__ import annotations

from pathlib import Path

import pytest
from tiny_models import write_onnx

from accelerators.onnx import Onnx
from pipeline.errors import DeviceError, ModelError


@pytest.fixture
def tiny(tmp_path: Path) -> str:
    write_onnx(tmp_path / "tiny.onnx")
    return str(tmp_path / "tiny.onnx")


def test_a_session_does_not_spin_and_has_the_threads_of_the_graph(tiny: str) -> None:
    session = Onnx(threads=2).load(tiny, {})._session  # type: ignore[attr-defined]
    options = session.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (2, 1)


def test_a_provider_that_is_not_there_is_refused_not_replaced(tiny: str) -> None:
    device = Onnx(provider="NoSuch")
    assert "no provider NoSuch, only " in device.probe().reason
    assert "install its build for NoSuch" in device.probe().reason
    with pytest.raises(DeviceError, match="no provider NoSuch"):
        device.load(tiny, {})


def test_a_provider_that_cannot_run_the_model_does_not_hand_it_to_the_cpu(tiny: str) -> None:
    device = Onnx(provider="Azure")  # in every build, and runs nothing here
    if not device.probe().available:
        pytest.skip("this onnxruntime has no second provider")
    with pytest.raises(ModelError, match=r"on Azure: .*fallback to CPU EP has been .*disabled"):
        device.load(tiny, {})
