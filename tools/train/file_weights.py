"""Weights to begin with from a file that flies: OpenVINO IR, as shipped and as trainings write it.

In such a file a batch normalization is folded into its convolution where it follows one. The
network that is given the weights answers as the file does; what its normalizations would have
measured is measured on one batch, so that learning goes on from there.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from accelerators.openvino import operations
from tools.train.beginning import Weights, first_channels

CONVOLUTIONS = ("Convolution", "GroupConvolution")
NORMALIZATION = "BatchNormalization"

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Layers:
    """What a file holds, by the module of the network that it was made of."""

    convolutions: Mapping[str, tuple[Array, Array | None]]  #: weights, bias
    normalizations: Mapping[str, tuple[Array, Array]]  #: scale, shift


def weights_of_file(network: nn.Module, file: Path, inputs: Tensor) -> Weights:
    """What an IR file has for the convolutions and normalizations of a network, of their shapes.
    Raises ModelError where the file cannot be read.

    `inputs` (n, channels, height, width), as the network gets them, tell what its normalizations
    would have measured. The network itself stays as it is.
    """
    known = dict(_fitting(network, _read(file)))
    filled = copy.deepcopy(network)
    modules = {name: one for name, one in filled.named_modules() if name in known}
    with torch.no_grad():
        for name, module in modules.items():
            _fill(module, *known[name])
    _measure(filled, list(modules.values()), inputs)
    return {
        f"{name}.{of}": weight
        for name, module in modules.items()
        for of, weight in module.state_dict().items()
    }


def _fitting(
    network: nn.Module, layers: _Layers
) -> Iterator[tuple[str, tuple[Array, Array | None]]]:
    """What the file has for each convolution and normalization of the network, of its shape."""
    for name, module in network.named_modules():
        if isinstance(module, nn.Conv2d):
            weight, bias = layers.convolutions.get(name, (None, None))
            if weight is None:
                continue
            fewer = first_channels(torch.from_numpy(weight), module.weight).numpy()
            if fewer.size == module.weight.numel():
                yield name, (fewer, bias)
        elif isinstance(module, nn.BatchNorm2d):
            if (own := layers.normalizations.get(name)) is not None:
                yield name, own
                continue
            folder, _, number = name.rpartition(".")
            before = f"{folder}.{int(number) - 1}" if number.isdecimal() else ""
            _, bias = layers.convolutions.get(before, (None, None))
            if bias is not None and len(bias) == module.num_features:
                yield name, (np.ones_like(bias), bias)


def _fill(module: nn.Module, weight: Array, bias: Array | None) -> None:
    """As the file: a normalization scales and shifts, and takes nothing for measured yet."""
    assert isinstance(module, nn.Conv2d | nn.BatchNorm2d)
    module.weight.copy_(torch.from_numpy(weight).reshape(module.weight.shape))
    if module.bias is not None and bias is not None:
        module.bias.copy_(torch.from_numpy(bias))
    if isinstance(module, nn.BatchNorm2d):
        assert module.running_mean is not None
        assert module.running_var is not None
        module.running_mean.zero_()
        module.running_var.fill_(1 - module.eps)


@torch.no_grad()
def _measure(network: nn.Module, filled: list[nn.Module], inputs: Tensor) -> None:
    """Let the filled normalizations measure the inputs, without a change of what they answer."""
    seen: list[tuple[nn.BatchNorm2d, Tensor, Tensor]] = []

    def look(module: nn.Module, given: tuple[Tensor, ...]) -> None:
        assert isinstance(module, nn.BatchNorm2d)
        variance, mean = torch.var_mean(given[0].float(), dim=(0, 2, 3))
        seen.append((module, mean, variance))

    norms = [one for one in filled if isinstance(one, nn.BatchNorm2d)]
    hooks = [one.register_forward_pre_hook(look) for one in norms]
    network.eval()(inputs)
    for hook in hooks:
        hook.remove()
    for module, mean, variance in seen:
        assert module.running_mean is not None
        assert module.running_var is not None
        module.running_mean.copy_(mean)
        module.running_var.copy_(variance)
        module.bias.add_(module.weight * mean)
        module.weight.mul_(torch.sqrt(variance + module.eps))


def _read(file: Path) -> _Layers:
    convolutions: dict[str, tuple[Array, Array | None]] = {}
    normalizations: dict[str, tuple[Array, Array]] = {}
    for node in operations(file):
        kind, module = node.get_type_name(), _module_of(node.get_friendly_name())
        if kind in CONVOLUTIONS:
            weight = _constant(node, 1)
            follower = next(iter(node.output(0).get_target_inputs())).get_node()
            bias = _constant(follower, 1) if follower.get_type_name() == "Add" else None
            if weight is not None:
                convolutions[module] = weight, None if bias is None else bias.ravel()
        elif kind == "Add" and node.get_friendly_name().endswith(f"/{NORMALIZATION}"):
            scale = _constant(node.input(0).get_source_output().get_node(), 1)
            shift = _constant(node, 1)
            if scale is not None and shift is not None:
                normalizations[module] = scale.ravel(), shift.ravel()
    return _Layers(convolutions, normalizations)


def _module_of(name: str) -> str:
    """`/network/levels.0/levels.0.1/body/Conv` is of module `levels.0.1.body`.

    A member of a sequence names the sequence again.
    """
    parts: list[str] = []
    for part in name.removesuffix("/WithoutBiases").split("/")[2:-1]:
        if parts and part.startswith(f"{parts[-1]}."):
            parts.pop()
        parts.append(part)
    return ".".join(parts)


def _constant(node: Any, number: int) -> Array | None:
    """An input that is a constant, of 16 or 32 bits."""
    if number >= node.get_input_size():
        return None
    source = node.input(number).get_source_output().get_node()
    if source.get_type_name() == "Convert":
        source = source.input(0).get_source_output().get_node()
    if source.get_type_name() != "Constant":
        return None
    return np.array(source.get_data(), dtype=np.float32)
