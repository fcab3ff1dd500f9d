"""What a training begins with instead of chance: the weights of another one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor, nn

from pipeline.errors import DataError
from tools.train.checkpoint import opened

#: What a network may take over from another one on the same backbone.
SHARED = ("backbone.", "pyramid.")

#: Parameters and buffers by their names, as `state_dict` has them.
Weights = Mapping[str, Tensor]


def begin_with(network: nn.Module, weights: Weights, told: Path) -> bool:
    """Give the network the weights: all of its own, or those of the backbone and pyramid of another
    network on the same ones. Whether all; DataError, naming where they are `told`, where neither
    fits, with the network as it was.

    A network of fewer input channels takes the weights of those that it has (`first_channels`).
    """
    mine = network.state_dict()
    fitting = {name: first_channels(weights[name], mine[name]) for name in mine.keys() & weights}
    fitting = {name: one for name, one in fitting.items() if one.shape == mine[name].shape}
    whole: bool = fitting.keys() == mine.keys()
    if not whole:
        shared = {name for name in mine if name.startswith(SHARED)}
        if not shared or not shared <= fitting.keys():
            raise DataError(
                f"{told}: cannot be begun with (neither the network nor its backbone and pyramid "
                "are the same); name the folder or .xml of a training of the same network"
            )
        fitting = {name: fitting[name] for name in shared}
    network.load_state_dict(fitting, strict=whole)
    return whole


def weights_of_training(checkpoint: Path) -> Weights:
    """The averaged weights of a training. Raises DataError where it is none, or broken."""
    with opened(
        checkpoint, purpose="be begun with", advice="name the folder of a training"
    ) as state:
        weights: Weights = state["averaged"]
    return weights


def first_channels(weight: Tensor, mine: Tensor) -> Tensor:
    """Weights (out, in, rows, columns) of the first input channels, where mine are fewer: a scan
    network without remission, the last of its channels, takes the rest for what it was."""
    if weight.ndim != 4 or mine.ndim != 4 or mine.shape[1] >= weight.shape[1]:
        return weight
    same = weight.shape[0] == mine.shape[0] and weight.shape[2:] == mine.shape[2:]
    return weight[:, : mine.shape[1]].clone() if same else weight
