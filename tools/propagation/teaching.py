"""The second half of a propagation: build the map, mend its ground, label every scan from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.kernels.compiled import as_input
from stages.kernels.geometry import has_return
from stages.kernels.ground import heights, without_smear
from stages.kernels.propagation import confident_labels
from stages.observed import Observation, Said, read_observation
from stages.taxonomy import load_taxonomy
from stages.types import SemanticVoxels
from stages.voxel_map import VoxelMap
from tools.propagation.dynamic import DynamicWindow, RecentHits, with_ahead
from tools.propagation.map_index import MapIndex
from tools.propagation.settings import GroundFix, Settings, Teacher

#: Classes that no return of a LiDAR can be: they stay in the map, where they outvote others.
NEVER_HIT = ("sky",)


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """What the whole recording says."""

    voxels: SemanticVoxels
    index: MapIndex
    smeared: int  #: voxels whose label the ground fix took
    scans: int  #: that are in it


@dataclass(frozen=True, slots=True, eq=False)
class Labeled:
    """A scan with its propagated labels."""

    observation: Observation
    labels: NDArray[np.uint8]  #: (n,) ids of the taxonomy, 0 unlabeled
    returns: NDArray[np.bool_]  #: (n,) points that could be labeled


def evidence_of(observation: Observation, teacher: Teacher) -> Said:
    """What the teacher's map is made of. Raises DataError where the graph has no LiDAR network."""
    if teacher is not Teacher.FUSED_MAP:
        return observation.camera
    if observation.fused is None:
        raise DataError(
            "the observations have no evidence of a LiDAR network: their graph has no fused cloud; "
            "take --from map, or a graph with a stage segment_scan"
        )
    return observation.fused


def build_map(
    files: Sequence[Path], settings: Settings, tick: Callable[[], None] = lambda: None
) -> Map:
    """The map of all scans with its labels. Raises DataError where no scan has a pose."""
    taxonomy = load_taxonomy()
    built = VoxelMap(voxel_m=settings.voxel_m, classes=len(taxonomy))
    scans = 0
    for file in files:
        tick()
        observation = read_observation(file)
        if settings.sound_only and observation.degraded:
            continue
        if observation.map_from_sensor is None:
            continue
        said = evidence_of(observation, settings.teacher)
        built.integrate(observation.cloud(said), observation.map_from_sensor, observation.stamp)
        scans += 1
    if not scans:
        what = "was made on sound devices and has a pose" if settings.sound_only else "has a pose"
        raise DataError(f"{files[0].parent}: none of the {len(files)} scans {what}")
    voxels = built.snapshot()
    if not len(voxels.indices):
        raise DataError(
            f"{files[0].parent}: the cameras said nothing of any point; do they look where the "
            "LiDAR does, and are their images near enough in time (in the graph, "
            "stages.camera_cloud.inputs.scores.tolerance_ms)?"
        )
    never = [taxonomy.id(name) for name in NEVER_HIT]
    labels = confident_labels(voxels.log_scores, len(taxonomy), settings.confidence, never)
    mended = labels
    if settings.ground is not GroundFix.NONE:
        tile_m = settings.tile_m if settings.ground is GroundFix.TILES else None
        reach_m = settings.ground_reach_m
        height_m = heights(voxels.positions, tile_m=tile_m, reach_m=reach_m)
        mended = without_smear(labels, height_m, taxonomy.ground, reach_m)
    index = MapIndex.of(voxels, len(taxonomy), settings.confidence, labels=mended)
    return Map(voxels, index, int(np.count_nonzero(labels != mended)), scans)


def overlay_labels(observation: Observation, confidence: float) -> NDArray[np.uint8]:
    """(n,) what the scan's own images say of its points, where they are sure."""
    taxonomy = load_taxonomy()
    never = [taxonomy.id(name) for name in NEVER_HIT]
    labels = np.zeros(len(observation.points), dtype=np.uint8)
    said = observation.camera
    labels[said.index] = confident_labels(said.rows(), len(taxonomy), confidence, never)
    return labels


def label_scans(files: Sequence[Path], settings: Settings, built: Map | None) -> Iterator[Labeled]:
    """Every scan with its labels, in order; `built` None where the overlay labels.

    Scans that are left out of the map (degraded, with `sound_only`) are left out here too.
    """
    if settings.teacher is Teacher.OVERLAY or built is None:
        for file in files:
            observation = read_observation(file)
            if settings.sound_only and observation.degraded:
                continue
            returns = has_return(as_input(observation.points), settings.min_range_m)
            labels = overlay_labels(observation, settings.confidence)
            yield Labeled(observation, np.where(returns, labels, 0).astype(np.uint8), returns)
        return
    yield from _label_from_map(files, settings, built)


def _label_from_map(files: Sequence[Path], settings: Settings, built: Map) -> Iterator[Labeled]:
    dynamic = load_taxonomy().dynamic
    hits = window = None
    reach = 0
    if settings.dynamic_within is not None:
        reach = settings.dynamic_within
        hits = RecentHits(built.index, dynamic, reach)
    if settings.dynamic_window is not None:
        reach = settings.dynamic_window
        classes = len(load_taxonomy())
        window = DynamicWindow(settings.voxel_m, classes, dynamic, settings.confidence, reach)
    for observation, ahead in with_ahead(files, reach):
        said = None
        if ahead is not None and not (settings.sound_only and ahead.degraded):
            said = evidence_of(ahead, settings.teacher)
        for one in (hits, window):
            if one is not None:
                one.enter(ahead, said)
        if observation is None or (settings.sound_only and observation.degraded):
            continue
        returns = has_return(as_input(observation.points), settings.min_range_m)
        pose = observation.map_from_sensor
        if pose is None:
            yield Labeled(observation, np.zeros(len(returns), dtype=np.uint8), returns)
            continue
        slots = built.index.slots(observation.points, returns, pose)
        labels = built.index.at(slots)
        if hits is not None:
            labels = np.where(hits.keeps(slots), labels, 0).astype(np.uint8)
        if window is not None:
            moving = window.labels(observation, returns)
            labels = np.where(moving > 0, moving, np.where(dynamic[labels], 0, labels))
        yield Labeled(observation, labels.astype(np.uint8), returns)
