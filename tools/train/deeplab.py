"""DeepLabv3+, the image segmentation network (Chen et al., ECCV 2018), on MobileNetV3."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from tools.train.blocks import ConvBn
from tools.train.mobilenet_v3 import MobileNetV3

#: Reach of the parallel convolutions, in cells of stride 16.
RATES = (6, 12, 18)


class AtrousPyramid(nn.Module):
    """Atrous spatial pyramid pooling: the same features seen at four reaches, and as a whole.

    What the whole image holds is projected apart and added, which is what a concatenation before
    the 1x1 convolution comes to, without an enlargement that the Edge TPU leaves to the CPU.
    """

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.reaches = nn.ModuleList(
            [
                ConvBn(before, after, 1),
                *(
                    nn.Sequential(
                        ConvBn(before, before, 3, groups=before, dilation=rate),
                        ConvBn(before, after, 1),
                    )
                    for rate in RATES
                ),
            ]
        )
        self.whole = nn.Sequential(
            nn.AdaptiveAvgPool2d(1),
            nn.Conv2d(before, after, 1),
            nn.ReLU6(),
            nn.Conv2d(after, after, 1),
        )
        self.joined = nn.Conv2d((1 + len(RATES)) * after, after, 1, bias=False)
        self.normalized = nn.Sequential(nn.BatchNorm2d(after), nn.ReLU6())

    def forward(self, x: Tensor) -> Tensor:
        near = self.joined(torch.cat([reach(x) for reach in self.reaches], dim=1))
        together: Tensor = self.normalized(near + self.whole(x))
        return together


class DeepLab(nn.Module):
    """Logits (n, classes, h, w) at stride 8 or 16 of images whose sides are 16 k + 1.

    Corners are aligned: the outer cells lie on the image's corner pixels; 849 x 481 gives 107 x 61
    cells, or 54 x 31. Enlarging them is for the stage that reads them, no work for an accelerator.
    """

    output_names = ("scores",)

    def __init__(
        self,
        classes: int,
        channels: int = 3,
        width: float = 1.0,
        *,
        stride: int = 8,
        pyramid: int = 128,
        minimalistic: bool = True,
    ) -> None:
        super().__init__()
        if stride not in (8, 16):
            raise ValueError(f"DeepLab gives logits at stride 8 or 16, not {stride}")
        self.backbone = MobileNetV3(channels, width, minimalistic=minimalistic)
        _, fine, coarse = self.backbone.widths
        self.pyramid = AtrousPyramid(coarse, pyramid)
        self.detail = ConvBn(fine, 48, 1) if stride == 8 else None
        joined = pyramid + (48 if stride == 8 else 0)
        self.decoder = nn.Sequential(
            ConvBn(joined, joined, 3, groups=joined), ConvBn(joined, pyramid, 1)
        )
        self.scores = nn.Conv2d(pyramid, classes, 1)

    def forward(self, image: Tensor) -> Tensor:
        _, fine, coarse = self.backbone(image)
        x = self.pyramid(coarse)
        if self.detail is not None:
            size = (fine.shape[2], fine.shape[3])
            x = functional.interpolate(x, size=size, mode="bilinear", align_corners=True)
            x = torch.cat((x, self.detail(fine)), dim=1)
        scores: Tensor = self.scores(self.decoder(x))
        return scores
