"""A backbone of full 3x3 convolutions alone: MobileDet's finding, taken to its end.

MobileDet puts full convolutions where an accelerator runs them well; CPUs with matrix units run
them best of all. At equal time for a frame this learns from three to four times as many crops a
minute as a MobileDet, whose depthwise convolutions are bound by memory.
"""

from __future__ import annotations

from torch import Tensor, nn

from tools.train.blocks import ConvBn, Residual


class ResidualBackbone(nn.Module):
    """Features at strides 4, 8, 16 and 32 of an image (n, channels, height, width)."""

    def __init__(
        self,
        channels: int = 1,
        widths: tuple[int, int, int, int] = (24, 56, 112, 160),
        pairs: tuple[int, int, int, int] = (1, 2, 2, 1),
        stem: int = 16,
    ) -> None:
        super().__init__()
        self.widths = widths  #: channels of the four features
        self.stem = ConvBn(channels, stem, stride=2)
        self.levels = nn.ModuleList(
            nn.Sequential(
                ConvBn(before, width, stride=2),
                *(
                    Residual(nn.Sequential(ConvBn(width, width), ConvBn(width, width)))
                    for _ in range(count)
                ),
            )
            for before, width, count in zip((stem, *widths), widths, pairs, strict=False)
        )

    @classmethod
    def slim(cls, channels: int) -> ResidualBackbone:
        """One of half the work, for the color cameras."""
        return cls(channels, widths=(16, 40, 80, 128), pairs=(1, 1, 2, 1))

    def forward(self, image: Tensor) -> list[Tensor]:
        x = self.stem(image)
        features = []
        for level in self.levels:
            x = level(x)
            features.append(x)
        return features
