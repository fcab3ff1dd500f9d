"""Camera images with what was found in them, for people to look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.message import Message, Span
from pipeline.stage import Stage
from stages.frames import look, map_from_sensor, mounted
from stages.kernels.compiled import as_input, locked
from stages.kernels.geometry import invert
from stages.kernels.probability import read_out
from stages.kernels.render import blend_classes, draw_box, draw_points, encode_png
from stages.kernels.sampling import sample_scores
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Calibration, ClassScores, Cloud, Detections, Image, Pose, Trajectory

NOWHERE = Calibration()


class PngOverlay(Stage):
    """Writes each `every`-th image with what was found in it to `folder`/`<stamp in ns>`.png.

    Scores are laid over the image in class colors, boxes drawn with class and score, and a cloud's
    points with evidence drawn in the color of their class, seen from the camera at the image's
    stamp. Boxes of other cameras are left out.
    """

    def __init__(
        self,
        *,
        folder: Path,
        every: int = 10,
        share: float = 0.5,
        calibration: Calibration = NOWHERE,
    ) -> None:
        """`share` of the class color in the blend, 0..1."""
        if every < 1:
            raise ValueError(f"every must be at least 1, not {every}")
        if not 0 <= share <= 1:
            raise ValueError(f"share must lie in 0..1, not {share}")
        self._folder = Path(folder)
        self._every = every
        self._share = share
        self._calibration = calibration
        self._taxonomy = load_taxonomy()
        self._seen = 0

    def process(
        self,
        image: Message[Image],
        scores: Message[ClassScores] | None = None,
        boxes: tuple[Message[Detections] | None, ...] = (),
        cloud: Message[Cloud] | None = None,
        trajectory: Span[Pose] | None = None,
    ) -> None:
        self._seen += 1
        if (self._seen - 1) % self._every:
            return
        picture = _as_rgb(image.payload.data)
        if scores:
            labels = self._labels(scores.payload)
            picture = blend_classes(picture, labels, self._taxonomy.colors, self._share)
        if cloud:
            path = Trajectory.of(trajectory) if trajectory else None
            self._draw_cloud(picture, image, cloud.payload, path)
        for found in boxes:
            if found and found.payload.camera == image.payload.camera:
                self._draw_boxes(picture, found.payload)
        with whole_file(self._folder / f"{image.stamp:020d}.png") as file:
            file.write(encode_png(picture))

    def _labels(self, scores: ClassScores) -> NDArray[np.uint8]:
        width, height = scores.size
        v, u = np.mgrid[:height, :width].astype(np.float32)
        rows, _ = sample_scores(
            locked(scores.grid),
            as_input(scores.rects),
            scores.scale,
            float(scores.zero_point),
            np.stack([u.ravel(), v.ravel()], axis=1),
            len(self._taxonomy),
        )
        labels: NDArray[np.uint8] = read_out(as_input(rows), len(self._taxonomy))[0]
        return labels.reshape(height, width)

    def _draw_cloud(
        self,
        picture: NDArray[np.uint8],
        image: Message[Image],
        cloud: Cloud,
        path: Trajectory | None,
    ) -> None:
        camera = image.payload.camera
        chain = mounted(self._calibration, camera, cloud.sensor)
        if path is not None and cloud.map_from_sensor is not None:
            map_from_camera = map_from_sensor(self._calibration, camera, image.stamp, path)
            if map_from_camera is None:
                return
            chain = invert(map_from_camera) @ cloud.map_from_sensor
        view = look(self._calibration.camera(camera), cloud.points, cloud.evidence, chain)
        far_first = np.argsort(-view.distance, kind="stable")
        rows = as_input(cloud.log_scores[view.index[far_first]])
        label = read_out(rows, len(self._taxonomy))[0]
        radius = max(0, round(picture.shape[1] / 1200))
        draw_points(picture, view.pixel[far_first], self._taxonomy.colors[label], radius)

    def _draw_boxes(self, picture: NDArray[np.uint8], found: Detections) -> None:
        for number in np.argsort(found.scores, kind="stable"):
            label = int(found.classes[number])
            text = f"{self._taxonomy.names[label]} {found.scores[number]:.2f}"
            draw_box(picture, found.boxes[number], text, self._taxonomy.colors[label].tolist())


def _as_rgb(data: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    """An RGB copy to draw on; 16-bit gray is stretched over its own range."""
    if data.dtype == np.uint16:
        low, high = int(data.min()), int(data.max())
        gray = np.rint((data.astype(np.float32) - low) * (255.0 / max(high - low, 1)))
    else:
        gray = data
    color = gray if gray.ndim == 3 else np.repeat(gray[..., None], 3, axis=2)
    return np.array(color, dtype=np.uint8, order="C")
