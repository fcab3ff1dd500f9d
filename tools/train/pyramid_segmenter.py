"""Segmentation on a feature pyramid (Kirillov et al., Panoptic FPN, CVPR 2019), down to stride 4.

It shares backbone and pyramid with the CenterNet detector, so that one can begin where the other
ended. Where persons are ten pixels wide, cells of eight pixels hold none of them whole.
"""

from __future__ import annotations

from torch import Tensor, nn

from tools.train.pyramid import Backbone, Pyramid

#: The strides of the pyramid's levels, finest first.
STRIDES = (4, 8, 16)


class PyramidSegmenter(nn.Module):
    """Logits (n, classes, h, w) at stride 4, 8 or 16 of images whose sides are 16 k + 1.

    Corners are aligned: cell i lies on pixel `stride` * i; 849 x 481 gives 213 x 121 cells at
    stride 4.
    """

    output_names = ("scores",)

    def __init__(
        self, backbone: Backbone, classes: int, *, stride: int = 4, neck: int = 32
    ) -> None:
        super().__init__()
        if stride not in STRIDES:
            raise ValueError(f"PyramidSegmenter gives logits at stride 4, 8 or 16, not {stride}")
        self._level = STRIDES.index(stride)
        self.backbone = backbone
        self.pyramid = Pyramid(backbone.widths, neck)
        self.scores = nn.Conv2d(neck, classes, 1)

    def forward(self, image: Tensor) -> Tensor:
        scores: Tensor = self.scores(self.pyramid(self.backbone(image))[self._level])
        return scores
