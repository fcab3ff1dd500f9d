"""SalsaNext, the network of LiDAR range images (Cortinhal, Tzelepis and Aksoy, ISVC 2020).

Convolutions have a bias, and LeakyReLU comes before the normalization, as published. The output is
logits: the published network ends in a soft-max, which fusion would have to undo.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

#: Share of whole channels that are dropped while training, at the published width. A narrow network
#: has none to spare: it gets its part of it.
DROPOUT = 0.2


class Layer(nn.Sequential):
    """Convolution, LeakyReLU and, by default, batch normalization; keeps the size."""

    def __init__(
        self,
        before: int,
        after: int,
        kernel: int = 3,
        dilation: int = 1,
        *,
        normalized: bool = True,
    ) -> None:
        padding = dilation * (kernel - 1) // 2
        layers: list[nn.Module] = [
            nn.Conv2d(before, after, kernel, padding=padding, dilation=dilation),
            nn.LeakyReLU(),
        ]
        if normalized:
            layers.append(nn.BatchNorm2d(after))
        super().__init__(*layers)


class Context(nn.Module):
    """What stands before the encoder: two wider looks at the same size, added to a 1x1."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.shortcut = Layer(before, after, 1, normalized=False)
        self.near = Layer(after, after)
        self.far = Layer(after, after, dilation=2)

    def forward(self, x: Tensor) -> Tensor:
        shortcut = self.shortcut(x)
        far: Tensor = self.far(self.near(shortcut))
        return shortcut + far


class Trio(nn.Module):
    """Three convolutions of growing reach, one after the other, fused by a 1x1."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.near = Layer(before, after)
        self.far = Layer(after, after, dilation=2)
        self.between = Layer(after, after, kernel=2, dilation=2)
        self.fused = Layer(3 * after, after, 1)

    def forward(self, x: Tensor) -> Tensor:
        near = self.near(x)
        far = self.far(near)
        between = self.between(far)
        fused: Tensor = self.fused(torch.cat((near, far, between), dim=1))
        return fused


class Down(nn.Module):
    """A block of the encoder: what it found at this size, and that at half of it."""

    def __init__(
        self, before: int, after: int, *, dropout: float = 0.0, pooled: bool = True
    ) -> None:
        super().__init__()
        self.shortcut = Layer(before, after, 1, normalized=False)
        self.body = Trio(before, after)
        self.dropout = nn.Dropout2d(dropout)
        self.pool = nn.AvgPool2d(3, 2, 1) if pooled else nn.Identity()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        whole = self.shortcut(x) + self.body(x)
        return whole, self.pool(self.dropout(whole))


class Up(nn.Module):
    """A block of the decoder: twice the size by pixel shuffle, together with the encoder's."""

    def __init__(self, before: int, skip: int, after: int, *, dropout: float = 0.0) -> None:
        super().__init__()
        self.shuffle = nn.PixelShuffle(2)
        self.body = Trio(before // 4 + skip, after)
        self.dropout = nn.Dropout2d(dropout)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        joined = torch.cat((self.dropout(self.shuffle(x)), skip), dim=1)
        dropped: Tensor = self.dropout(self.body(self.dropout(joined)))
        return dropped


class SalsaNext(nn.Module):
    """Logits (n, classes, h, w) of range images (n, channels, h, w), sides multiples of 16.

    `width` scales all channels; at 1 they start at 32, and 20 classes make 6,711,572 parameters.
    """

    output_names = ("scores",)

    def __init__(self, classes: int, channels: int = 5, width: float = 1.0) -> None:
        super().__init__()
        drop = DROPOUT * min(1.0, width**2)
        base = max(8, 4 * round(32 * width / 4))  # the pixel shuffle divides by 4
        self.context = nn.Sequential(
            Context(channels, base), Context(base, base), Context(base, base)
        )
        self.down1 = Down(base, 2 * base)
        self.down2 = Down(2 * base, 4 * base, dropout=drop)
        self.down3 = Down(4 * base, 8 * base, dropout=drop)
        self.down4 = Down(8 * base, 8 * base, dropout=drop)
        self.down5 = Down(8 * base, 8 * base, dropout=drop, pooled=False)
        self.up1 = Up(8 * base, 8 * base, 4 * base, dropout=drop)
        self.up2 = Up(4 * base, 8 * base, 4 * base, dropout=drop)
        self.up3 = Up(4 * base, 4 * base, 2 * base, dropout=drop)
        self.up4 = Up(2 * base, 2 * base, base)
        self.scores = nn.Conv2d(base, classes, 1)

    def forward(self, image: Tensor) -> Tensor:
        skip1, x = self.down1(self.context(image))
        skip2, x = self.down2(x)
        skip3, x = self.down3(x)
        skip4, x = self.down4(x)
        _, x = self.down5(x)
        x = self.up1(x, skip4)
        x = self.up2(x, skip3)
        x = self.up3(x, skip2)
        scores: Tensor = self.scores(self.up4(x, skip1))
        return scores
