"""Mean and standard deviation of a range image's channels, over any number of scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def moments(channels: NDArray[np.float32], min_range_m: float = 0.0) -> NDArray[np.float64]:
    """(3, channels) number, sum and sum of squares over the cells with a return at least
    `min_range_m` away; they add up.

    `channels` (channels, rows, columns) as `fill_channels` gives them for mean 0 and std 1.
    """
    counted = (channels[0] > 0) & (channels[0] >= min_range_m)
    values = channels[:, counted].astype(np.float64)
    count = np.full(len(values), values.shape[1], dtype=np.float64)
    return np.stack([count, values.sum(axis=1), (values**2).sum(axis=1)])


def mean_and_std(
    total: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and standard deviation (channels,) of added-up `moments`, of a sensor's own data.

    A channel that does not vary gets std 1, so that it becomes 0. No cell at all: mean 0, std 1.
    """
    count = np.maximum(total[0], 1.0)
    mean = total[1] / count
    std = np.sqrt(np.maximum(total[2] / count - mean**2, 0.0))
    return mean.astype(np.float32), np.where(std > 1e-6, std, 1.0).astype(np.float32)


def adapted(
    network: NDArray[np.float32], own: NDArray[np.float32], *, remission: bool = True
) -> NDArray[np.float32]:
    """The network's mean or std (4,) or (5,) with z and remission of a sensor's own data.

    Both sensors see all around, so range, x and y stay as the network knows them (the paper's
    adaptation); its height above ground and its remission differ. Where both report remission
    alike, its mean only tells how often each material was hit: `remission` False keeps it.
    """
    result = network.copy()
    end = len(network) if remission else 4
    result[3:end] = own[3:end]
    return result
