"""MobileNetV3-Large, the backbone of the image segmentation (Howard et al., ICCV 2019, table 1).

`minimalistic` is the authors' own variant for accelerators: no squeeze-and-excite, no hard-swish,
no 5x5 convolutions. It is the default: hard-swish is no operation of the Edge TPU.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from tools.train.blocks import ConvBn, Residual, scaled

#: Kernel, expanded channels, channels, squeeze-and-excite, hard-swish, stride.
TABLE: Sequence[tuple[int, int, int, bool, bool, int]] = (
    (3, 16, 16, False, False, 1),
    (3, 64, 24, False, False, 2),
    (3, 72, 24, False, False, 1),
    (5, 72, 40, True, False, 2),
    (5, 120, 40, True, False, 1),
    (5, 120, 40, True, False, 1),
    (3, 240, 80, False, True, 2),
    (3, 200, 80, False, True, 1),
    (3, 184, 80, False, True, 1),
    (3, 184, 80, False, True, 1),
    (3, 480, 112, True, True, 1),
    (3, 672, 112, True, True, 1),
    (5, 672, 160, True, True, 2),
    (5, 960, 160, True, True, 1),
    (5, 960, 160, True, True, 1),
)
#: The stride at which dense predictions stop: from here on, dilation takes its place.
OUTPUT_STRIDE = 16


class SqueezeExcite(nn.Module):
    """Weighs the channels by what the whole image holds of them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        narrow = scaled(channels, 0.25)
        self.weigh = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(channels, narrow, 1),
            nn.ReLU(),
            nn.Conv2d(narrow, channels, 1),
            nn.Hardsigmoid(),
        )

    def forward(self, x: Tensor) -> Tensor:
        weight: Tensor = self.weigh(x)
        return x * weight


class MobileNetV3(nn.Module):
    """Features at strides 4, 8 and 16 of an image; the last with the reach of stride 32."""

    def __init__(self, channels: int = 3, width: float = 1.0, *, minimalistic: bool = True) -> None:
        super().__init__()
        stem = scaled(16, width)
        swish: type[nn.Module] = nn.ReLU6 if minimalistic else nn.Hardswish
        blocks: list[nn.Module] = [ConvBn(channels, stem, 3, 2, activation=swish)]
        ends: dict[int, int] = {}  # by stride: after which block its features are there
        widths: dict[int, int] = {}
        before, stride, dilation = stem, 2, 1
        for kernel, expanded, count, excite, hard_swish, step in TABLE:
            if step == 2 and stride == OUTPUT_STRIDE:
                step, dilation = 1, 2
            stride *= step
            after = scaled(count, width)
            blocks.append(
                _inverted(
                    before,
                    scaled(expanded, width),
                    after,
                    3 if minimalistic else kernel,
                    step,
                    dilation,
                    excite=excite and not minimalistic,
                    activation=swish if hard_swish else nn.ReLU6 if minimalistic else nn.ReLU,
                )
            )
            before = after
            ends[stride], widths[stride] = len(blocks) - 1, after
        self.blocks = nn.ModuleList(blocks)
        self._ends = (ends[4], ends[8], ends[16])
        self.widths = (widths[4], widths[8], widths[16])  #: channels of the three features

    def forward(self, image: Tensor) -> list[Tensor]:
        features = []
        x = image
        for number, block in enumerate(self.blocks):
            x = block(x)
            if number in self._ends:
                features.append(x)
        return features


def _inverted(
    before: int,
    wide: int,
    after: int,
    kernel: int,
    stride: int,
    dilation: int,
    *,
    excite: bool,
    activation: type[nn.Module],
) -> nn.Module:
    layers: list[nn.Module] = []
    if wide != before:
        layers.append(ConvBn(before, wide, 1, activation=activation))
    layers.append(
        ConvBn(wide, wide, kernel, stride, groups=wide, dilation=dilation, activation=activation)
    )
    if excite:
        layers.append(SqueezeExcite(wide))
    layers.append(ConvBn(wide, after, 1, activation=None))
    body = nn.Sequential(*layers)
    return Residual(body) if stride == 1 and before == after else body
