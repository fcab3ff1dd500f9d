"""What the kernels are measured on: a street of boxes, seen by a LiDAR and a camera with depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.kernels.geometry import invert
from stages.kernels.warp import viewing_rays
from stages.types import CHANNELS, Calibration

CLASSES = 15
BUILDING, ROAD, PERSON, VEHICLE = 1, 3, 5, 13
SCAN = (128, 1024)
WIDTH, HEIGHT = 848, 480
ELEVATION_RAD = (-np.pi / 4, np.pi / 4)
VOXEL_M = 0.25

LENS = {"size": [WIDTH, HEIGHT], "fx": 424.0, "fy": 424.0, "cx": 423.5, "cy": 239.5}
FORWARD = [[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, -0.1], [0, 0, 0, 1]]
#: A camera that looks ahead of the LiDAR, and a thermal one beside it.
CALIBRATION = Calibration.parse(
    {
        "lidar": {"base_from_sensor": np.eye(4).tolist()},
        "rgb": {"base_from_sensor": FORWARD, "camera": LENS},
        "thermal": {
            "base_from_sensor": [*FORWARD[:1], [-1, 0, 0, -0.2], *FORWARD[2:]],
            "camera": {"size": [640, 512], "fx": 420.0, "fy": 420.0, "cx": 319.5, "cy": 255.5},
        },
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One instant."""

    map_from_base: NDArray[np.float64]  #: (4, 4)
    points: NDArray[np.float32]  #: (131072, 3) m, zeros without a return
    point_labels: NDArray[np.uint8]  #: (131072,)
    depth: NDArray[np.uint16]  #: (HEIGHT, WIDTH) mm
    labels: NDArray[np.uint8]  #: (HEIGHT, WIDTH)
    boxes: dict[str, NDArray[np.float32]]  #: by camera, (n, 4) around persons and vehicles, pixels


def frames(count: int) -> list[Frame]:
    """The street in steps of 10 cm ahead, with a little yaw: 10 Hz at 1 m/s."""
    boxes, labels = street(np.random.default_rng(0))
    return [frame(boxes, labels, 0.1 * number, 0.004 * number) for number in range(count)]


def street(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Boxes (n, 6) lowest and highest corner, m, and their classes: facades, vehicles, persons."""
    kinds: list[tuple[int, NDArray[np.float64]]] = []
    for side in (-1.0, 1.0):
        for number in range(10):
            depth, y = rng.uniform(8, 15), side * rng.uniform(9, 12)
            x, height = -60 + 12.0 * number, rng.uniform(10, 25)
            near, far = min(y, y + side * depth), max(y, y + side * depth)
            kinds.append((BUILDING, np.array([x, near, 0, x + 11.0, far, height])))
        for number in range(6):
            x, y = -32 + 11.0 * number + rng.uniform(0, 3), side * 5.5
            kinds.append((VEHICLE, np.array([x, y - 0.9, 0, x + 4.4, y + 0.9, 1.5])))
    for _ in range(8):
        x, y = rng.uniform(4, 14), rng.uniform(-3.5, 3.5)
        kinds.append((PERSON, np.array([x, y, 0, x + 0.4, y + 0.6, 1.8])))
    boxes = np.array([box for _, box in kinds], dtype=np.float32)
    return boxes, np.array([label for label, _ in kinds], dtype=np.uint8)


def frame(
    boxes: NDArray[np.float32], labels: NDArray[np.uint8], ahead_m: float, yaw_rad: float
) -> Frame:
    """What the sensors see from 2.5 m above the road."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    pose[:3, 3] = ahead_m, 0.0, 2.5
    rows, columns = SCAN
    elevation = np.pi / 4 - (np.arange(rows)[:, None] + 0.5) * np.pi / 2 / rows
    azimuth = np.pi - (np.arange(columns) + 0.5) * 2 * np.pi / columns
    flat = np.cos(elevation)
    beams = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1
    ).reshape(-1, 3)
    ranges, point_labels = cast(beams @ pose[:3, :3].T, pose[:3, 3], boxes, labels)
    noise = np.random.default_rng(1).normal(0, 0.01, len(ranges))
    points = beams * np.where(ranges > 0, ranges + noise, 0)[:, None]
    camera = CALIBRATION.sensor("rgb")
    assert camera.camera is not None
    rays = viewing_rays(WIDTH, HEIGHT, camera.camera.intrinsics()).reshape(2, -1)
    ahead = np.stack([*rays, np.ones_like(rays[0])], axis=1)
    map_from_camera = pose @ camera.base_from_sensor
    seen, pixel_labels = cast(
        ahead @ map_from_camera[:3, :3].T, map_from_camera[:3, 3], boxes, labels
    )
    millimeters = np.where(seen < 20, seen * 1000, 0).reshape(HEIGHT, WIDTH)
    return Frame(
        pose,
        points.astype(np.float32),
        point_labels,
        millimeters.astype(np.uint16),
        pixel_labels.reshape(HEIGHT, WIDTH),
        {
            name: largest(boxes[(labels == PERSON) | (labels == VEHICLE)], pose, name)
            for name in CALIBRATION.cameras()
        },
    )


def largest(
    solids: NDArray[np.float32], map_from_base: NDArray[np.float64], name: str
) -> NDArray[np.float32]:
    """The five boxes (5, 4) in a camera's image that show most of solids (n, 6) ahead of it."""
    camera, mount = CALIBRATION.camera(name), CALIBRATION.sensor(name).base_from_sensor
    corners = solids[:, [[x, y, z] for x in (0, 3) for y in (1, 4) for z in (2, 5)]]
    camera_from_map = invert(map_from_base @ mount)
    there = corners @ camera_from_map[:3, :3].T + camera_from_map[:3, 3]  # (n, 8, 3)
    there = there[(there[..., 2] > 0.5).all(axis=1)]
    pixel = there[..., :2] / there[..., 2:] * camera.fx + (camera.cx, camera.cy)
    edge = np.array(camera.size) - 1.0
    low, high = (pixel.min(axis=1), pixel.max(axis=1))
    low, high = np.clip(low, 0, edge), np.clip(high, 0, edge)
    order = np.argsort(-(high - low).prod(axis=1), kind="stable")[:5]
    return np.concatenate([low, high], axis=1)[order].astype(np.float32)


@compiled
def cast(
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
    boxes: NDArray[np.float32],
    labels: NDArray[np.uint8],
) -> Any:
    """How many times its length each ray (n, 3) goes until it meets a box or the road at z = 0
    (n,), 0 where it meets nothing within 100, and the class there (n,) uint8, 0 where nothing."""
    reach = np.empty(len(rays))
    hit = np.empty(len(rays), dtype=np.uint8)
    for i in range(len(rays)):
        nearest, label = 100.0, 0
        down = -origin[2] / rays[i, 2] if rays[i, 2] < 0.0 else np.inf
        if down < nearest:
            nearest, label = down, ROAD
        for b in range(len(boxes)):
            enter, leave = 0.0, nearest
            for axis in range(3):
                step = rays[i, axis] if rays[i, axis] != 0.0 else 1e-12
                one = (boxes[b, axis] - origin[axis]) / step
                other = (boxes[b, axis + 3] - origin[axis]) / step
                enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
            if 0.0 < enter < leave:
                nearest, label = enter, labels[b]
        reach[i] = nearest if label > 0 else 0.0
        hit[i] = label
    return reach, hit


def log_scores(labels: NDArray[np.uint8], seed: int) -> NDArray[np.float32]:
    """What a network may say of pixels or points of these classes: (..., CHANNELS) float32."""
    scores = np.random.default_rng(seed).normal(0, 1.5, (*labels.shape, CHANNELS))
    np.put_along_axis(scores, labels[..., None].astype(np.int64), 4.0, axis=-1)
    return scores.astype(np.float32)
