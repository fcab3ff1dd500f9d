"""MobileDet for the Edge TPU, the backbone of the detectors (Xiong et al., CVPR 2021, fig 7).

Unlike MobileNets it mixes full convolutions in where accelerators are fast with them: `fused` (a
full convolution that expands) and `tucker` (one between two narrow 1x1 ones) beside the usual
inverted bottleneck with its depthwise convolution.
"""

from __future__ import annotations

from torch import Tensor, nn

from tools.train.blocks import ConvBn, Residual, scaled


def _joined(layers: list[nn.Module], *, residual: bool) -> nn.Module:
    body = nn.Sequential(*layers)
    return Residual(body) if residual else body


def inverted(
    before: int, after: int, expansion: int, kernel: int = 3, stride: int = 1, residual: bool = True
) -> nn.Module:
    """1x1 expansion, depthwise convolution, linear 1x1 projection."""
    wide = before * expansion
    return _joined(
        [
            ConvBn(before, wide, 1),
            ConvBn(wide, wide, kernel, stride, groups=wide),
            ConvBn(wide, after, 1, activation=None),
        ],
        residual=residual,
    )


def fused(
    before: int, after: int, expansion: int, kernel: int = 3, stride: int = 1, residual: bool = True
) -> nn.Module:
    """A full convolution that expands, linear 1x1 projection."""
    wide = before * expansion
    return _joined(
        [ConvBn(before, wide, kernel, stride), ConvBn(wide, after, 1, activation=None)],
        residual=residual,
    )


def tucker(before: int, after: int, input_rank: float, output_rank: float) -> nn.Module:
    """1x1 compression, a full convolution between the ranks, linear 1x1 projection."""
    narrow_in, narrow_out = scaled(before, input_rank), scaled(after, output_rank)
    return nn.Sequential(
        ConvBn(before, narrow_in, 1),
        ConvBn(narrow_in, narrow_out, 3),
        ConvBn(narrow_out, after, 1, activation=None),
    )


class MobileDet(nn.Module):
    """Features at strides 4, 8, 16 and 32 of an image (n, channels, height, width).

    `width` scales all channels (a multiple of 8 each). At width 1 and three input channels the
    layers are those of the published backbone, up to C5.
    """

    def __init__(self, channels: int = 3, width: float = 1.0) -> None:
        super().__init__()
        stem, c1, c2, c3, c4, c4_wide, c5, c5_wide = (
            scaled(n, width) for n in (32, 16, 16, 40, 72, 96, 120, 384)
        )
        self.stage1 = nn.Sequential(ConvBn(channels, stem, 3, 2), tucker(stem, c1, 0.25, 0.75))
        self.stage2 = nn.Sequential(
            fused(c1, c2, 8, stride=2, residual=False),
            fused(c2, c2, 4),
            fused(c2, c2, 8),
            fused(c2, c2, 4),
        )
        self.stage3 = nn.Sequential(
            fused(c2, c3, 8, kernel=5, stride=2, residual=False),
            *(fused(c3, c3, 4) for _ in range(3)),
        )
        self.stage4 = nn.Sequential(
            inverted(c3, c4, 8, stride=2, residual=False),
            inverted(c4, c4, 8),
            fused(c4, c4, 4),
            fused(c4, c4, 4),
            inverted(c4, c4_wide, 8, kernel=5, residual=False),
            inverted(c4_wide, c4_wide, 8, kernel=5),
            inverted(c4_wide, c4_wide, 8),
            inverted(c4_wide, c4_wide, 8),
        )
        self.stage5 = nn.Sequential(
            inverted(c4_wide, c5, 8, kernel=5, stride=2, residual=False),
            inverted(c5, c5, 8),
            inverted(c5, c5, 4, kernel=5),
            inverted(c5, c5, 8),
            inverted(c5, c5_wide, 8, kernel=5, residual=False),
        )
        self.widths = (c2, c3, c4_wide, c5_wide)  #: channels of the four features

    def forward(self, image: Tensor) -> list[Tensor]:
        c2 = self.stage2(self.stage1(image))
        c3 = self.stage3(c2)
        c4 = self.stage4(c3)
        return [c2, c3, c4, self.stage5(c4)]
