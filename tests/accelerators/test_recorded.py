from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tiny_models import SHAPE, write_onnx

from accelerators.emulated import Emulated
from accelerators.onnx import Onnx
from accelerators.recorded import Record, Recorded
from pipeline.errors import DeviceError, ModelError
from pipeline.model import Accelerator, Model

VARIANT = {"model": "tiny", "kind": "onnx"}
X = [np.full(SHAPE, value, np.float32) for value in (-1, 2, 3)]


def load(device: Accelerator, folder: Path) -> Model:
    write_onnx(folder / "tiny.onnx")
    return device.load(str(folder / "tiny.onnx"), VARIANT)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """The answers to two of the three inputs."""
    device = Record(device=Onnx(), path=tmp_path / "run")
    model = load(device, tmp_path)
    for x in (X[0], X[1], X[0]):
        model.infer({"x": x})
    device.close()
    return tmp_path / "run"


def test_a_recorded_run_answers_as_the_network_did(recording: Path, tmp_path: Path) -> None:
    device = Recorded(path=recording)
    model = load(device, tmp_path)
    assert device.kinds == Onnx.kinds
    assert model.inputs == load(Onnx(), tmp_path).inputs
    for x in reversed(X[:2]):
        np.testing.assert_array_equal(model.infer({"x": x})["y1"], np.maximum(x, 0))


def test_an_input_that_was_not_recorded_is_refused(recording: Path, tmp_path: Path) -> None:
    model = load(Recorded(path=recording), tmp_path)
    for x in (X[2], X[0].astype(np.float64)):
        with pytest.raises(DeviceError, match="this input was not recorded; record the run again"):
            model.infer({"x": x})


def test_an_emulated_device_may_answer_from_a_recorded_run(recording: Path, tmp_path: Path) -> None:
    device = Emulated(latency_ms={"tiny": 0}, outputs=Recorded(path=recording))
    runtime = device.probe().runtime
    assert "emulated" in runtime
    assert "recorded answers of onnxruntime" in runtime
    assert (load(device, tmp_path).infer({"x": X[1]})["y1"] == 2).all()


def test_a_model_that_was_not_recorded_is_refused(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no answers of model 'other', only of tiny"):
        Recorded(path=recording).load("", {"model": "other", "kind": "onnx"})


def test_a_folder_without_a_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=f"path {tmp_path} holds no recorded answers"):
        Recorded(path=tmp_path)


def test_a_run_that_was_cut_off_leaves_only_whole_answers(recording: Path) -> None:
    files = sorted(file.suffix for file in (recording / "tiny").iterdir())
    assert files == [".npz", ".npz"]
