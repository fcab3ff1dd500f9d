"""How labels are propagated: everything a person may choose, as one frozen value."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Teacher(StrEnum):
    """Who labels the points."""

    CAMERA_MAP = "map"  #: the map of what the cameras said, over the whole recording
    OVERLAY = "overlay"  #: each scan's own camera images
    FUSED_MAP = "fused"  #: the map with the LiDAR network's evidence in it


class GroundFix(StrEnum):
    """How the ground is known."""

    TILES = "tiles"  #: a plane per tile, for slopes
    PLANE = "plane"  #: one for the map
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Settings:
    """Choices of one propagation; see `overflight propagate --help`."""

    teacher: Teacher = Teacher.CAMERA_MAP
    confidence: float = 0.80
    voxel_m: float = 0.25
    ground: GroundFix = GroundFix.TILES
    tile_m: float = 20.0
    ground_reach_m: float = 0.20
    min_range_m: float = 1.0  #: nearer points are the vehicle itself
    dynamic_window: int | None = None  #: scans before and after, None: the whole recording
    dynamic_within: int | None = None  #: scans, None: no limit
    sound_only: bool = False  #: leave out what was made while a device was degraded
