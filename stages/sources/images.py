"""A folder of pictures as a camera of its own rate."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import DataError
from pipeline.message import Message
from pipeline.stage import Source, Timing
from stages.sources.pictures import SUFFIXES, read_picture
from stages.sources.stamps import Stamps
from stages.types import Image


class ImageFolder(Source):
    """The pictures of `path` in the order of their names: 8-bit RGB, or 8- or 16-bit gray.

    The folder carries no stamps, so picture k is stamped `offset_ms` + k / `rate_hz`, with jitter
    on request.
    """

    def __init__(
        self,
        *,
        path: Path,
        camera: str = "camera",
        rate_hz: float = 10.0,
        offset_ms: float = 0.0,
        jitter_ms: float = 0.0,
        delay_ms: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.path = path
        self.camera = camera
        self._stamps = Stamps(rate_hz, offset_ms, jitter_ms, delay_ms, seed)

    def open(self) -> None:
        if not self.path.is_dir():
            raise DataError(f"{self.path}: no such folder")
        self._files = sorted(f for f in self.path.iterdir() if f.suffix.lower() in SUFFIXES)
        if not self._files:
            raise DataError(f"{self.path}: holds no picture ({', '.join(SUFFIXES)})")

    def messages(self) -> Iterator[Message[Image]]:
        for frame, stamp in self._stamps.of(range(len(self._files))):
            image = Image(read_picture(self._files[frame]), self.camera)
            yield Message.at(stamp, image, received=self._stamps.arrival(stamp))

    def last_arrival(self) -> int:
        return self._stamps.last_arrival(range(len(self._files)))

    def timing(self) -> Timing:
        return self._stamps.timing()
