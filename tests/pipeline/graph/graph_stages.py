"""Stages, devices and models that the tests of the graph file name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pipeline.errors import ModelError
from pipeline.message import Message, Span
from pipeline.model import Accelerator, BoundModel, ModelSpec, Tensors
from pipeline.stage import ModelStage, Source, Stage, Timing, ports


@dataclass(frozen=True)
class Image:
    """A picture."""


@dataclass(frozen=True)
class GrayImage(Image):
    """A picture without color."""


@dataclass(frozen=True)
class Boxes:
    """Things found in a picture."""


@dataclass(frozen=True)
class Scan:
    """Points."""


@dataclass(frozen=True)
class Pose:
    """Where the vehicle is."""


@dataclass(frozen=True)
class Rig:
    """Where the sensors sit, as a `calibration:` block says."""

    sensors: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def parse(cls, block: Mapping[str, Any]) -> Rig:
        for name, value in block.items():
            if not isinstance(value, (int, float)):
                raise ValueError(f"{name}: give the height in meters")
        return cls(dict(block))


def rig_of_folder(*, path: Path) -> Rig:
    """A calibration that a recording brings along."""
    return Rig({path.name: 1.0})


class Camera(Source):
    """A camera.

    `rate_hz` is the rate of its frames.
    """

    def __init__(
        self, *, rate_hz: float = 30.0, delay_ms: float = 0.0, jitter_ms: float = 0.0
    ) -> None:
        if rate_hz <= 0:
            raise ValueError(f"rate_hz must be above 0, not {rate_hz}")
        self.rate_hz = rate_hz
        self.delay_ms = delay_ms
        self.jitter_ms = jitter_ms

    def messages(self) -> Iterator[Message[GrayImage]]:
        return iter(())

    def timing(self) -> Timing:
        return Timing(self.rate_hz, self.delay_ms, self.jitter_ms)


class Lidar(Source):
    """A LiDAR with a recording behind it."""

    def __init__(self, *, path: Path, delay_ms: float = 50.0, rows: int = 16) -> None:
        self.path = path
        self.delay_ms = delay_ms
        self.rows = rows

    def messages(self) -> Iterator[Message[Scan]]:
        return iter(())

    def timing(self) -> Timing:
        return Timing(10.0, self.delay_ms)


class Odometry(Source):
    """Poses, at a rate that is not known before."""

    def messages(self) -> Iterator[Message[Pose]]:
        return iter(())


class Detect(ModelStage):
    """Things in a picture."""

    def __init__(self, *, min_score: float = 0.5, mode: Literal["fast", "exact"] = "fast") -> None:
        self.min_score = min_score

    def prepare(self, image: Message[Image]) -> Tensors:
        return {}

    def finish(self, outputs: Tensors, image: Message[Image]) -> Boxes | None:
        return Boxes()


class Blur(Stage):
    """A picture less sharp."""

    inline = True

    def process(self, image: Message[Image]) -> Image:
        return image.payload


class Fuse(Stage):
    """Boxes and a picture in the points of a scan."""

    def process(
        self,
        scan: Message[Scan],
        poses: Span[Pose],
        boxes: tuple[Message[Boxes] | None, ...] = (),
        image: Message[Image] | None = None,
    ) -> Scan:
        return scan.payload


class Pair(Stage):
    """Two pictures of one instant."""

    def process(self, left: Message[Image], right: Message[Image]) -> Image:
        return left.payload


class Mount(Stage):
    """A scan in the frame of the vehicle."""

    def __init__(self, *, calibration: Rig, sensor: str = "lidar") -> None:
        self.height = calibration.sensors[sensor]

    def process(self, scan: Message[Scan]) -> Scan:
        return scan.payload


@ports
@dataclass(frozen=True)
class Halves:
    """The two halves of a picture."""

    left: GrayImage | None
    right: Message[Image] | None


class Split(Stage):
    """A picture in two."""

    def process(self, image: Message[Image]) -> Halves | None:
        return None


class Save(Stage):
    """A sink for everything."""

    def __init__(self, *, path: Path | None = None, paths: tuple[Path, ...] = ()) -> None:
        self.path = path
        self.paths = paths

    def process(self, thing: Message[Any]) -> None:
        return None


class Unsaid(Stage):
    """A stage whose author forgot an annotation."""

    def process(self, image) -> Image:  # type: ignore[no-untyped-def]
        return Image()


class Endless(Stage):
    """A stage that could live without inputs."""

    def process(self, image: Message[Image] | None = None) -> None:
        return None


class Chip:
    """An accelerator that runs one kind of model."""

    kinds = ("chip",)

    def __init__(self, *, threads: int = 1, cache: Path | None = None) -> None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self.threads = threads
        self.cache = cache


class Oven(Chip):
    """An accelerator that runs no model of the catalog."""

    kinds = ("oven",)


class Models:
    """A catalog of two models for the chip."""

    def names(self) -> Sequence[str]:
        return ["detect-rgb", "segment-rgb"]

    def spec(self, name: str) -> ModelSpec:
        return ModelSpec(name, "image", (48, 64, 3), "uint8", "rgb")

    def check(self, name: str, device: Accelerator) -> str | None:
        if "chip" in device.kinds:
            return None
        return f"model '{name}' has no variant for {type(device).__name__}; it has chip"

    def load(self, name: str, device: Accelerator) -> BoundModel:
        raise ModelError(name)
