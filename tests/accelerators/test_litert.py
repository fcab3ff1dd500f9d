from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from tiny_models import SHAPE, write_tflite

from accelerators.litert import TfliteCpu
from accelerators.tflite_file import cut
from pipeline.errors import ModelError

DEEPLAB = "deeplab_mobilenet_edgetpu_slim_cityscapes_quant"


def test_a_model_cut_at_a_tensor_computes_that_tensor_only(tmp_path: Path) -> None:
    path = tmp_path / "chain.tflite"
    write_tflite(path, operators=3)
    model = TfliteCpu().load(str(path), {"outputs": {"y": {"tensor": 2}}})
    assert list(model.outputs) == ["y2"]
    found = model.infer({"x": np.full(SHAPE, 4, np.float32)})
    assert (found["y2"] == 4).all()


@pytest.mark.parametrize(
    ("tensors", "said"),
    [([0], "no operator computes tensor 0"), ([9], "tensor 9"), ([1, 2], "1 outputs, 2 tensors")],
)
def test_a_cut_that_is_impossible_says_why(tmp_path: Path, tensors: list[int], said: str) -> None:
    path = tmp_path / "chain.tflite"
    write_tflite(path, operators=3)
    with pytest.raises(ValueError, match=said):
        cut(path.read_bytes(), tensors)
    outputs = {str(tensor): {"tensor": tensor} for tensor in tensors}
    with pytest.raises(ModelError, match=rf"chain.tflite: .*{said}"):
        TfliteCpu().load(str(path), {"outputs": outputs})


def test_the_cut_network_gives_bit_for_bit_what_the_whole_one_computes_there(shared: Path) -> None:
    interpreter = pytest.importorskip("ai_edge_litert.interpreter")
    path = shared / "models" / "coral" / f"{DEEPLAB}.tflite"
    image = np.random.default_rng(0).integers(0, 256, (1, 513, 513, 3), dtype=np.uint8)
    model = TfliteCpu().load(str(path), {"outputs": {"scores": {"tensor": 210}}})
    (name,) = model.inputs
    found = model.infer({name: image})["ResizeBilinear"]

    with pytest.warns(UserWarning, match="preserve_all_tensors"):
        whole = interpreter.Interpreter(
            model_path=str(path), num_threads=1, experimental_preserve_all_tensors=True
        )
    whole.allocate_tensors()
    whole.set_tensor(whole.get_input_details()[0]["index"], image)
    whole.invoke()
    np.testing.assert_array_equal(found, whole.get_tensor(210))


def test_a_model_compiled_for_the_edge_tpu_is_answered_with_the_way_out(shared: Path) -> None:
    path = shared / "models" / "coral" / f"{DEEPLAB}_edgetpu.tflite"
    with pytest.raises(ModelError, match="compiled for the Edge TPU and cannot run on a CPU; name"):
        TfliteCpu().load(str(path), {})


def test_tflite_runtime_under_numpy_2_is_found_out_by_building_an_interpreter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It imports, and only its first interpreter fails, with an error that says nothing."""
    broken = types.ModuleType("tflite_runtime.interpreter")

    def interpreter(**settings: object) -> None:
        raise SystemError("<built-in method ...> returned a result with an exception set")

    broken.Interpreter = interpreter  # type: ignore[attr-defined]
    broken.load_delegate = None  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tflite_runtime", types.ModuleType("tflite_runtime"))
    monkeypatch.setitem(sys.modules, "tflite_runtime.interpreter", broken)
    probe = TfliteCpu(tflite_backend="tflite_runtime").probe()
    assert not probe.available
    assert "which also holds numpy below 2" in probe.reason
    assert "ai-edge-litert" in TfliteCpu(tflite_backend="auto").probe().runtime


def test_a_backend_that_is_not_installed_says_what_to_install() -> None:
    probe = TfliteCpu(tflite_backend="tflite_runtime").probe()
    if probe.available:
        pytest.skip("tflite-runtime works here")
    assert "tflite-runtime does not start" in probe.reason
    assert "pip install 'overflight[tflite-runtime]'" in probe.reason
