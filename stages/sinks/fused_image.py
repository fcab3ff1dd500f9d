"""Fused images in class colors, over the camera's image, for people to look at."""

from __future__ import annotations

from pathlib import Path

from pipeline.message import Message
from pipeline.stage import Stage
from stages.draw_fused import check_share, drawn
from stages.fused import FusedImage
from stages.kernels.render import encode_png
from stages.sinks.whole_file import whole_file
from stages.types import Image


class FusedOverlay(Stage):
    """Writes each `every`-th fused image to `folder`/`<stamp in ns>.png`.

    With its `image` (``sync: exact``) the classes are laid over it and background leaves it as it
    is; without, the picture is the mask in class colors.
    """

    def __init__(self, *, folder: Path, every: int = 10, share: float = 0.5) -> None:
        """`share` of the class color in the blend, 0..1."""
        if every < 1:
            raise ValueError(f"every must be at least 1, not {every}")
        check_share(share)
        self._folder = Path(folder)
        self._every = every
        self._share = share
        self._seen = 0

    def process(self, fused: Message[FusedImage], image: Message[Image] | None = None) -> None:
        self._seen += 1
        if (self._seen - 1) % self._every:
            return
        picture = drawn(fused.payload, image.payload if image else None, self._share)
        with whole_file(self._folder / f"{fused.stamp:020d}.png") as file:
            file.write(encode_png(picture))
