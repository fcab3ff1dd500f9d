"""The CenterNet detector: a feature pyramid down to stride 4, and objects as peaks of a map there.

Anchors that match small objects need stride 4 and sides of 10 px (219,000 anchors at 640 x 512); a
heat map at that stride does the same with 20,480 cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from tools.train.blocks import ConvBn
from tools.train.pyramid import Backbone, Pyramid

#: Pixels of the picture per cell of the outputs.
STRIDE = 4
#: What the heat of an empty cell starts at: with it the focal loss begins small.
PRIOR = 0.01


class CenterNet(nn.Module):
    """`heat` (n, classes, h, w) logits, `size` and `offset` (n, 2, h, w) of an image at stride 4.

    `size` is the logarithm of width and height, `offset` the way from the cell's center to the
    object's, all in cells. A logarithm keeps its relative precision in 8 bits, for a box of 10 px
    as of 120 px.
    """

    output_names = ("heat", "size", "offset")

    def __init__(self, backbone: Backbone, classes: int, neck: int = 32, head: int = 48) -> None:
        super().__init__()
        self.backbone = backbone
        self.pyramid = Pyramid(backbone.widths, neck)
        self.head = ConvBn(neck, head)
        self.heat = nn.Conv2d(head, classes, 1)
        self.size = nn.Conv2d(head, 2, 1)
        self.offset = nn.Conv2d(head, 2, 1)
        nn.init.constant_(self.heat.bias, float(torch.logit(torch.tensor(PRIOR))))
        for convolution in (self.heat, self.size, self.offset):
            nn.init.normal_(convolution.weight, std=0.01)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        x = self.head(self.pyramid(self.backbone(image))[0])
        return {"heat": self.heat(x), "size": self.size(x), "offset": self.offset(x)}

    def registry_head(self) -> Mapping[str, Any]:
        """What the registry says of the outputs."""
        return {"kind": "centernet", "log_size": True, "cell_center": 0.5}
