"""Who labels how much: the single overlay, the camera-only map, the fused map, over all scans.

On a simulated flight, which knows its truth, also how much of it is right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.recording.mcap import McapReader
from stages.evaluation_groups import load_groups
from stages.kernels.compiled import as_input
from stages.kernels.evaluation import agreement, group_columns
from stages.kernels.geometry import has_return
from stages.kernels.metrics import WIDTH, confusion, merge_groups
from stages.labels import Labels
from stages.observed import Observation, read_observation
from stages.sources.recording import Recording
from stages.taxonomy import load_taxonomy
from tools.propagation.settings import Settings, Teacher
from tools.propagation.teaching import Map, build_map, overlay_labels

CAPTIONS = {
    Teacher.OVERLAY: "single overlay",
    Teacher.CAMERA_MAP: "camera-only map",
    Teacher.FUSED_MAP: "fused map",
}


@dataclass(slots=True)
class Share:
    """What one teacher labels."""

    returns: int = 0
    labeled: int = 0
    by_class: NDArray[np.int64] = field(default_factory=lambda: np.zeros(WIDTH, np.int64))
    matrix: NDArray[np.int64] = field(default_factory=lambda: np.zeros((WIDTH, WIDTH), np.int64))

    def add(
        self,
        labels: NDArray[np.uint8],
        returns: NDArray[np.bool_],
        truth: NDArray[np.integer[Any]] | None,
    ) -> None:
        """One scan: labels, which points are returns, what is true of them (n,)."""
        said = labels[returns]
        self.returns += len(said)
        self.labeled += int(np.count_nonzero(said))
        self.by_class += np.bincount(said, minlength=WIDTH)[:WIDTH]
        if truth is not None:
            given = said > 0
            self.matrix += confusion(truth[returns][given], said[given])

    def told(self) -> dict[str, Any]:
        """For the report."""
        names = load_taxonomy().names
        told: dict[str, Any] = {
            "labeled_share": self.labeled / max(self.returns, 1),
            "classes": {
                names[k]: int(self.by_class[k]) for k in range(1, len(names)) if self.by_class[k]
            },
        }
        if self.matrix.any():
            groups = load_groups("paper")
            judged = agreement(merge_groups(self.matrix, group_columns(groups)))
            told["right_share"] = float(np.trace(self.matrix[1:, 1:])) / int(self.matrix[1:].sum())
            told["iou_of_labeled"] = {
                name: float(judged.iou[k])
                for k, name in enumerate(groups, start=1)
                if judged.points[k]
            }
        return told


class Truth:
    """What is true of the scans of a simulated flight, by stamp; empty for other recordings."""

    def __init__(self, recording: Path) -> None:
        self._recording = recording
        self._by_sensor: dict[str, Iterator[Any]] = {}
        self._topics: Sequence[str] = ()
        if recording.is_file():
            self._topics = list(McapReader(recording).channels())

    def of(self, observation: Observation) -> NDArray[np.uint8] | None:
        """(n,) the classes of a scan, asked for by rising stamps; None where nothing is known."""
        labels = self.labels_of(observation)
        return None if labels is None else labels.classes.ravel()

    def labels_of(self, observation: Observation) -> Labels | None:
        """Classes and instances of a scan, as `of`."""
        topic = f"truth/{observation.sensor}"
        if topic not in self._topics:
            return None
        if topic not in self._by_sensor:
            source = Recording(path=self._recording, topic=topic)
            source.open()
            self._by_sensor[topic] = source.messages()
        for message in self._by_sensor[topic]:
            if message.stamp == observation.stamp and isinstance(message.payload, Labels):
                fits = message.payload.classes.size == len(observation.points)
                return message.payload if fits else None
            if message.stamp > observation.stamp:
                return None
        return None


def survey(
    files: Sequence[Path],
    settings: Settings,
    camera_map: Map | None,
    recording: Path,
    show: Callable[[int, Observation, Mapping[str, NDArray[np.uint8] | None]], None],
    tick: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Shares by teacher over all scans; `show` gets the labelings of each by their captions."""
    maps: dict[Teacher, Map] = {}
    if camera_map is not None:
        maps[Teacher.CAMERA_MAP] = camera_map
    else:
        own = replace(settings, teacher=Teacher.CAMERA_MAP)
        maps[Teacher.CAMERA_MAP] = build_map(files, own)
    if read_observation(files[0]).fused is not None:
        maps[Teacher.FUSED_MAP] = build_map(files, replace(settings, teacher=Teacher.FUSED_MAP))
    shares = {teacher: Share() for teacher in CAPTIONS}
    truths = Truth(recording)
    for number, file in enumerate(files):
        tick()
        observation = read_observation(file)
        if settings.sound_only and observation.degraded:
            continue
        truth = truths.of(observation)
        returns = has_return(as_input(observation.points), settings.min_range_m)
        labelings: dict[str, NDArray[np.uint8] | None] = {}
        for teacher, caption in CAPTIONS.items():
            labels = _labels(teacher, maps, observation, returns, settings)
            if labels is None:
                labelings[f"{caption}: the graph has no LiDAR network"] = None
                continue
            shares[teacher].add(labels, returns, truth)
            share = np.count_nonzero(labels) / max(int(np.count_nonzero(returns)), 1)
            labelings[f"{caption}: labels {100 * share:.0f} %"] = labels
        show(number, observation, labelings)
    return {t.value: share.told() for t, share in shares.items() if share.returns}


def _labels(
    teacher: Teacher,
    maps: Mapping[Teacher, Map],
    observation: Observation,
    returns: NDArray[np.bool_],
    settings: Settings,
) -> NDArray[np.uint8] | None:
    if teacher is Teacher.OVERLAY:
        labels = overlay_labels(observation, settings.confidence)
        return np.where(returns, labels, 0).astype(np.uint8)
    if teacher not in maps:
        return None
    if observation.map_from_sensor is None:
        return np.zeros(len(returns), dtype=np.uint8)
    index = maps[teacher].index
    return index.at(index.slots(observation.points, returns, observation.map_from_sensor))
