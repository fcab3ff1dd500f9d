"""Images as files, one each."""

from __future__ import annotations

from pathlib import Path

from pipeline.message import Message
from pipeline.stage import Stage
from stages.camera_image import eight_bit
from stages.kernels.render import encode_png
from stages.sinks.whole_file import whole_file
from stages.types import Image


class WritePictures(Stage):
    """Writes each `every`-th image to `folder`/`<stamp in ns>.png`; 16 bits are stretched to 8."""

    def __init__(self, *, folder: Path, every: int = 1) -> None:
        if every < 1:
            raise ValueError(f"every must be at least 1, not {every}")
        self._folder = Path(folder)
        self._every = every
        self._seen = 0

    def process(self, image: Message[Image]) -> None:
        self._seen += 1
        if (self._seen - 1) % self._every == 0:
            with whole_file(self._folder / f"{image.stamp:020d}.png") as file:
                file.write(encode_png(eight_bit(image.payload)))
