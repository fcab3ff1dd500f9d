"""A trained network as files that fly: ONNX, OpenVINO IR of 16-bit weights, 8-bit TensorFlow Lite.

Every file is run against the network it was made of. A float one that says something else is
refused; for an 8-bit one the difference is told: an untrained network may drown in its rounding.
"""

from __future__ import annotations

import contextlib
import copy
import io
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from accelerators.litert import TfliteCpu
from accelerators.onnx import Onnx
from accelerators.openvino import OpenVino, write_ir
from pipeline.errors import ModelError
from pipeline.model import Native

#: How far a file may be from its network, as a share of the network's output (roots of mean
#: squares): float files lose the order of additions, IR also the last bits of its 16-bit weights.
TOLERANCE = {"onnx": 1e-4, "openvino": 2e-2, "tflite": 1e-3}
#: By so many times that may one value be off, as a share of the greatest: a SalsaNext
#: answered to noise with 2.3 % at its worst of half a million values, 0.4 % in the mean.
FARTHEST = 5


@dataclass(frozen=True, slots=True)
class Exportable:
    """A network and what its files are to be like."""

    name: str
    network: nn.Module
    shape: tuple[int, int, int]  #: channels, height, width of the input
    outputs: tuple[str, ...]  #: names in the file, in this order


class InOrder(nn.Module):
    """The network with its outputs as a tuple: what exporters understand, whatever it gives."""

    def __init__(self, network: nn.Module, outputs: Sequence[str]) -> None:
        super().__init__()
        self.network = network
        self._outputs = tuple(outputs)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        found = self.network(image)
        return tuple(found[name] for name in self._outputs) if isinstance(found, dict) else (found,)


def write_onnx(model: Exportable, folder: Path) -> Path:
    """`folder`/`name`.onnx, float, channels first. Raises ModelError where it differs."""
    path = folder / f"{model.name}.onnx"
    probe = _probe(model)
    with _quiet():
        torch.onnx.export(
            InOrder(model.network, model.outputs).eval(),
            (probe,),
            str(path),
            input_names=["image"],
            output_names=list(model.outputs),
            opset_version=17,
            dynamo=False,
        )
    found = Onnx().load(str(path), {}).infer({"image": probe.numpy()})
    _compare(path, model, probe, found, TOLERANCE["onnx"])
    return path


def write_openvino(model: Exportable, onnx: Path, folder: Path) -> Path:
    """`folder`/`name`.xml with its .bin of 16-bit weights. Raises ModelError where it differs."""
    path = folder / f"{model.name}.xml"
    write_ir(onnx, path)
    probe = _probe(model)
    found = OpenVino().load(str(path), {}).infer({"image": probe.numpy()})
    _compare(path, model, probe, found, TOLERANCE["openvino"])
    return path


def write_tflite(model: Exportable, samples: Sequence[NDArray[np.float32]], folder: Path) -> Path:
    """`folder`/`name`_int8.tflite, channels last, 8-bit from its input to its outputs.

    `samples` (channels, height, width), as the network gets them, tell which values each tensor
    takes. Raises ModelError without the extra `export`.
    """
    try:
        with _quiet():
            import litert_torch
            from ai_edge_quantizer import quantizer, recipe
    except ImportError as error:
        raise ModelError(
            f"8-bit files need the extra 'export' (pip install 'overflight[export]'): {error}"
        ) from None
    path = folder / f"{model.name}_int8.tflite"
    # Of weights laid out channels last, litert-torch 0.10 makes other weights.
    plain = copy.deepcopy(model.network).to(memory_format=torch.contiguous_format)
    in_order = InOrder(plain, model.outputs).eval()
    with torch.no_grad():
        maps = [n for n, output in enumerate(in_order(_probe(model))) if output.ndim == 4]
    ordered = litert_torch.to_channel_last_io(in_order, args=[0], outputs=maps).eval()
    channels, height, width = model.shape
    with _quiet():
        converted = litert_torch.convert(ordered, (torch.zeros(1, height, width, channels),))
        with tempfile.TemporaryDirectory() as workbench:
            whole = Path(workbench) / "float.tflite"
            converted.export(str(whole))
            _compare_tflite(whole, path, model, maps)
            tool = quantizer.Quantizer(str(whole), recipe.static_wi8_ai8())
            batches = [{"args_0": sample.transpose(1, 2, 0)[None]} for sample in samples]
            result = tool.quantize(tool.calibrate({"serving_default": batches}))
            eight_bit = Path(workbench) / "eight_bit.tflite"
            result.export_model(str(eight_bit))
            _write_plain(eight_bit, model.outputs, path)
    return path


def _probe(model: Exportable) -> Tensor:
    """An input of noise, the same each time."""
    values = np.random.default_rng(0).uniform(-1, 1, (1, *model.shape))
    return torch.from_numpy(values.astype(np.float32))


@torch.no_grad()
def _compare(
    path: Path,
    model: Exportable,
    probe: Tensor,
    found: Native,
    tolerance: float,
) -> None:
    wanted = InOrder(model.network, model.outputs).eval()(probe)
    for name, one in zip(model.outputs, wanted, strict=True):
        reference, other = one.numpy(), found[name]
        if reference.shape != other.shape:
            raise ModelError(
                f"{path}: '{name}' is {other.shape}, the network gives {reference.shape}"
            )
        size = max(float(np.sqrt(np.mean(reference**2))), 1e-6)
        difference = float(np.sqrt(np.mean((reference - other) ** 2))) / size
        worst = float(np.abs(reference - other).max() / max(np.abs(reference).max(), 1e-6))
        if not (difference <= tolerance and worst <= FARTHEST * tolerance):
            raise ModelError(
                f"{path}: '{name}' differs from the network by {difference:.2g} of its size in the "
                f"mean (root of squares) and by {worst:.2g} of its largest value at worst, allowed "
                f"are {tolerance:.2g} and {FARTHEST * tolerance:.2g}; this exporter cannot be "
                "trusted with it"
            )


def _compare_tflite(whole: Path, path: Path, model: Exportable, maps: Sequence[int]) -> None:
    """Hold the float file that the 8-bit one is made of against the network."""
    probe = _probe(model)
    file = TfliteCpu().load(str(whole), {})
    said = file.infer({next(iter(file.inputs)): probe.numpy().transpose(0, 2, 3, 1)})
    found = {
        name: said[key].transpose(0, 3, 1, 2) if index in maps else said[key]
        for index, (name, key) in enumerate(zip(model.outputs, file.outputs, strict=True))
    }
    _compare(path, model, probe, found, TOLERANCE["tflite"])


def _write_plain(converted: Path, outputs: Sequence[str], path: Path) -> None:
    """The file with short names, and with its weights inside the FlatBuffer, where every reader
    looks for them: the quantizer appends them, which is newer than the Edge TPU's compiler."""
    from ai_edge_quantizer.utils.tfl_flatbuffer_utils import flatbuffer_utils

    model = flatbuffer_utils.read_model(str(converted))
    graph = model.subgraphs[0]
    for number, tensor in enumerate(graph.tensors):
        tensor.name = f"tensor_{number}".encode()
    graph.tensors[graph.inputs[0]].name = b"image"
    for number, name in zip(graph.outputs, outputs, strict=True):
        graph.tensors[number].name = name.encode()
    flatbuffer_utils.write_model(model, str(path))


@torch.no_grad()
def rounding(path: Path, model: Exportable, sample: NDArray[np.float32]) -> dict[str, float]:
    """By output: how far an 8-bit file is from its network over a sample, root mean square, as a
    share of what the output varies by."""
    file = TfliteCpu().load(str(path), {})
    (name, spec), *_ = file.inputs.items()
    stored = np.rint(sample.transpose(1, 2, 0)[None] / spec.scale) + spec.zero_point
    limits = np.iinfo(spec.dtype)
    found = file.infer({name: np.clip(stored, limits.min, limits.max).astype(spec.dtype)})
    wanted = InOrder(model.network, model.outputs).eval()(torch.from_numpy(sample[None]))
    shares = {}
    for output, one in zip(model.outputs, wanted, strict=True):
        form = file.outputs[output]
        other = (found[output].astype(np.float32) - form.zero_point) * form.scale
        other = other.transpose(0, 3, 1, 2) if other.ndim == 4 else other
        difference = np.sqrt(np.mean((other - one.numpy()) ** 2))
        shares[output] = float(difference / max(float(one.std()), 1e-9))
    return shares


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Exporters talk much, some past Python's own streams; what goes wrong is raised, not said."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
            Path(os.devnull).open("wb") as nowhere,
        ):
            warnings.simplefilter("ignore")
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        logging.disable(before)
