"""The feature pyramid between a backbone and the heads of a detector (Lin et al., CVPR 2017)."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional

from tools.train.blocks import ConvBn
from tools.train.mobiledet import MobileDet
from tools.train.residual_backbone import ResidualBackbone

#: What gives features at strides 4, 8, 16 and 32, of `widths` channels.
Backbone = MobileDet | ResidualBackbone


class Pyramid(nn.Module):
    """The features, coarsest last, of `neck` channels and each with what the coarser ones know."""

    def __init__(self, widths: Sequence[int], neck: int) -> None:
        super().__init__()
        self.lateral = nn.ModuleList(ConvBn(count, neck, 1, activation=None) for count in widths)
        self.smooth = nn.ModuleList(ConvBn(neck, neck) for _ in widths[:-1])

    def forward(self, features: Sequence[Tensor]) -> list[Tensor]:
        x = self.lateral[-1](features[-1])
        levels = [x]
        for level in reversed(range(len(self.smooth))):
            finer = self.lateral[level](features[level])
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            if x.shape != finer.shape:  # a side that does not divide by 32 was rounded up
                x = x[:, :, : finer.shape[2], : finer.shape[3]]
            x = self.smooth[level](x + finer)
            levels.insert(0, x)
        return levels
