"""What a training begins with instead of chance: the weights of another one."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from pipeline.errors import DataError

#: What a network may take over from another one on the same backbone.
SHARED = ("backbone.", "pyramid.")


def begin_with(network: nn.Module, checkpoint: Path) -> bool:
    """Give the network the averaged weights of a training: all of them, or those of the backbone
    and pyramid of another network on the same ones. Whether all; DataError where they do not fit.

    A network of fewer input channels takes the weights of those that it has (`first_channels`).
    """
    try:
        weights = torch.load(checkpoint, weights_only=True)["averaged"]
        mine = network.state_dict()
        whole: bool = weights.keys() == mine.keys()
        if not whole:
            weights = {name: one for name, one in weights.items() if name.startswith(SHARED)}
            if weights.keys() != {name for name in mine if name.startswith(SHARED)}:
                raise KeyError("neither the network nor its backbone and pyramid are the same")
        weights = {name: first_channels(one, mine[name]) for name, one in weights.items()}
        network.load_state_dict(weights, strict=whole)
        return whole
    except (RuntimeError, KeyError, EOFError, OSError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(
            f"{checkpoint}: cannot be begun with ({reason}); name the folder of a training of the "
            "same network"
        ) from None


def first_channels(weight: Tensor, mine: Tensor) -> Tensor:
    """Weights (out, in, rows, columns) of the first input channels, where mine are fewer: a scan
    network without remission, the last of its channels, takes the rest for what it was."""
    if weight.ndim != 4 or mine.ndim != 4 or mine.shape[1] >= weight.shape[1]:
        return weight
    same = weight.shape[0] == mine.shape[0] and weight.shape[2:] == mine.shape[2:]
    return weight[:, : mine.shape[1]].clone() if same else weight
