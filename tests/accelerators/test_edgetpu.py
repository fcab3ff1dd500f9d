"""The path to an Edge TPU, over a stub of its library; what needs the device itself is not here."""

from __future__ import annotations

import logging
import subprocess
from pathlib import Path

import numpy as np
import pytest
from stub_edgetpu import stub, stub_library
from tiny_models import SHAPE, write_edgetpu, write_tflite

from accelerators.litert import EdgeTpu, TfliteCpu
from accelerators.registry import Registry
from accelerators.tflite_file import cut, read_graph
from pipeline.drivers.isolated import IsolatedDevice
from pipeline.errors import DeviceError, ModelError
from pipeline.graph.graph import load_graph

TWIN = "deeplab_mobilenet_edgetpu_slim_cityscapes_quant_edgetpu.tflite"


def test_a_library_that_is_missing_is_named_with_what_to_install() -> None:
    probe = EdgeTpu(library="libedgetpu_of_nobody.so.1").probe()
    assert not probe.available
    assert probe.reason == (
        "libedgetpu_of_nobody.so.1 is not installed; install the Edge TPU runtime (libedgetpu1-std)"
    )


def test_a_library_that_the_edge_tpus_stands_on_is_named_with_its_package(tmp_path: Path) -> None:
    stub_library()  # skips without a compiler
    usb, edgetpu = tmp_path / "libusb-1.0.so.99", tmp_path / "libedgetpu.so"
    source = tmp_path / "empty.c"
    source.write_text("int nothing;")
    command = ["cc", "-shared", "-fPIC", str(source), "-o"]
    subprocess.run([*command, str(usb), f"-Wl,-soname,{usb.name}"], check=True)
    subprocess.run([*command, str(edgetpu), "-Wl,--no-as-needed", str(usb)], check=True)
    usb.unlink()
    reason = EdgeTpu(library=str(edgetpu)).probe().reason
    assert reason == (
        f"{edgetpu} needs libusb-1.0.so.99, which is not installed; install libusb-1.0-0"
    )


def test_a_library_for_another_machine_is_told_from_one_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "libedgetpu.so").write_text("for another processor")
    reason = EdgeTpu(library=str(tmp_path / "libedgetpu.so")).probe().reason
    assert "cannot be loaded" in reason
    assert "install libedgetpu1-std for this machine" in reason


def test_a_library_that_is_no_delegate_is_told_from_a_device_that_is_missing() -> None:
    reason = EdgeTpu(library="libm.so.6").probe().reason
    assert reason == "libm.so.6 is no TensorFlow Lite delegate; name libedgetpu under 'library'"


def test_a_device_that_is_missing_is_told_where_libedgetpu_says_nothing(tmp_path: Path) -> None:
    write_edgetpu(tmp_path / "tiny.tflite")
    device = EdgeTpu(device="usb:9", library=stub_library())
    assert device.probe().reason.startswith("no Edge TPU ")
    with pytest.raises(DeviceError, match="no Edge TPU "):
        device.load(str(tmp_path / "tiny.tflite"), {})


def test_what_the_library_says_itself_is_kept() -> None:
    reason = EdgeTpu(device="pci:9", library=stub_library()).probe().reason
    assert reason.endswith("(stub: pci:9 is on fire)")


@pytest.mark.parametrize(
    ("device", "options"), [(None, b""), ("usb", b"device=usb;"), ("pci:0", b"device=pci:0;")]
)
def test_the_library_is_asked_for_the_device_of_the_graph(
    device: str | None, options: bytes
) -> None:
    assert EdgeTpu(device=device, library=stub_library()).probe().available
    assert stub().stub_options() == options


@pytest.mark.parametrize("device", ["USB", "usb:", "usb:x", "pcie:0", "tpu", ""])
def test_a_device_that_libedgetpu_would_not_understand_is_a_bad_option(device: str) -> None:
    with pytest.raises(ValueError, match="is no Edge TPU; write usb, pci, usb:0 or pci:0"):
        EdgeTpu(device=device)


def test_a_probe_shows_both_versions_that_have_to_fit_and_lets_the_device_go() -> None:
    before = stub().stub_alive()
    probe = EdgeTpu(library=stub_library()).probe()
    assert "libedgetpu stub 1.0" in probe.runtime
    assert "ai-edge-litert" in probe.runtime or "tflite-runtime" in probe.runtime
    assert stub().stub_alive() == before


def test_each_model_has_a_delegate_of_its_own_that_goes_with_it(tmp_path: Path) -> None:
    write_edgetpu(tmp_path / "tiny.tflite")
    before = stub().stub_alive()
    device = EdgeTpu(library=stub_library())
    models = [device.load(str(tmp_path / "tiny.tflite"), {}) for _ in range(2)]
    assert stub().stub_alive() == before + 2
    device.close()
    del models
    assert stub().stub_alive() == before


def test_a_device_that_is_pulled_out_fails_the_run_and_no_more(tmp_path: Path) -> None:
    write_edgetpu(tmp_path / "tiny.tflite")
    model = EdgeTpu(library=stub_library()).load(str(tmp_path / "tiny.tflite"), {})
    x = np.full(SHAPE, 2, np.float32)
    stub().stub_unplug(1)
    try:
        with pytest.raises(DeviceError, match=r"tiny\.tflite: "):
            model.infer({"x": x})
    finally:
        stub().stub_unplug(0)
    assert (model.infer({"x": x})["y1"] == 2).all()


def test_a_model_that_is_not_compiled_is_refused_rather_than_run_on_the_cpu(tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    with pytest.raises(ModelError, match=r"is not compiled for the Edge TPU, so all of it would"):
        EdgeTpu(library=stub_library()).load(str(tmp_path / "tiny.tflite"), {})


def test_a_compiled_model_is_refused_on_the_cpu(tmp_path: Path) -> None:
    write_edgetpu(tmp_path / "tiny.tflite")
    with pytest.raises(ModelError, match=r"is compiled for the Edge TPU and cannot run on a CPU"):
        TfliteCpu().load(str(tmp_path / "tiny.tflite"), {})


def test_what_the_compiler_left_to_the_cpu_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_tflite(tmp_path / "half.tflite", operators=3, compiled=1)
    device = EdgeTpu(library=stub_library())
    with caplog.at_level(logging.WARNING):
        device.load(str(tmp_path / "half.tflite"), {})
    assert "the CPU runs what the compiler left: RELU, RELU" in caplog.text
    caplog.clear()
    first = device.load(str(tmp_path / "half.tflite"), {"outputs": {"y": {"tensor": 1}}})
    assert list(first.outputs) == ["y1"]
    assert not caplog.text


def test_the_public_twin_cut_where_the_compiler_stopped_leaves_nothing_to_the_cpu(
    shared: Path,
) -> None:
    content = (shared / "models" / "coral" / TWIN).read_bytes()
    names = [operation.name for operation in read_graph(content).operations]
    assert names == ["edgetpu-custom-op", "RESIZE_BILINEAR", "ARG_MAX"]
    graph = read_graph(cut(content, [3]))
    assert [operation.name for operation in graph.operations] == ["edgetpu-custom-op"]
    (scores,) = (graph.tensors[number] for number in graph.outputs)
    assert (scores.name, scores.spec.shape) == ("ResizeBilinear", (1, 33, 33, 19))


REGISTRY = """
models:
  tiny:
    description: relu
    license: Apache-2.0
    source: the tests
    input: {name: x, shape: [2, 3, 3], dtype: float32}
    head: {kind: none}
    variants:
      - {kind: tflite, file: tiny.tflite, outputs: {y: {}}}
      - {kind: edgetpu, file: tiny_edgetpu.tflite, outputs: {y: {}}}
"""


def test_one_model_runs_on_edge_tpu_and_cpu_each_with_its_own_file(tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    write_edgetpu(tmp_path / "tiny_edgetpu.tflite")
    (tmp_path / "models.yaml").write_text(REGISTRY)
    models = Registry.open(tmp_path / "models.yaml")
    for device in (EdgeTpu(library=stub_library()), TfliteCpu()):
        assert models.check("tiny", device) is None
        assert models.load("tiny", device).spec.name == "tiny"


GRAPH = """
overflight: 1
graph: look
devices:
  tpu: {use: accelerators.litert:EdgeTpu, library: LIBRARY}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera, options: {width: 32, height: 16}}
"""


@pytest.mark.slow
def test_a_graph_gives_it_a_process_of_its_own(tmp_path: Path) -> None:
    write_edgetpu(tmp_path / "tiny.tflite")
    (tmp_path / "graph.yaml").write_text(GRAPH.replace("LIBRARY", stub_library()))
    device = load_graph(tmp_path / "graph.yaml", catalog=Registry.open()).devices["tpu"]
    assert device.isolation is not None, "an unfit libedgetpu would kill the whole graph"
    alive = stub().stub_alive()
    tpu = IsolatedDevice(device, device.isolation)
    try:
        assert tpu.probe().available
        model = tpu.load(str(tmp_path / "tiny.tflite"), {})
        x = np.linspace(-1, 1, 18, dtype=np.float32).reshape(SHAPE)
        np.testing.assert_array_equal(model.infer({"x": x})["y1"], np.maximum(x, 0))
        assert stub().stub_alive() == alive, "it was opened in this process"
    finally:
        tpu.close()
