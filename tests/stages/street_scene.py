"""Streets seen by a LiDAR and a camera from 5 m above, with the exact class of everything.

Ray casting against a few shapes: ground, a facade, and before it cars, persons and bicycles. What
the networks say of it is worse than the truth in the ways they are: the image's classes bleed over
edges and are noisy, the LiDAR network is wrong about patches, boxes are loose and some are missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.message import Message
from stages.types import (
    PADDING_LOG,
    Calibration,
    ClassScores,
    Cloud,
    DepthImage,
    Detections,
    Pose,
)

C = 15
BUILDING, ROAD, PERSON, VEGETATION, SKY, BICYCLE, VEHICLE = 1, 3, 5, 7, 8, 11, 13
THINGS = (PERSON, BICYCLE, VEHICLE)

ROWS, COLUMNS = 128, 1024  #: of an OS0-128
WIDTH, HEIGHT, STRIDE = 320, 240, 4  #: of the images, and pixels per cell of their scores
FOCAL = 210.0
ABOVE_GROUND_M = 5.0
DOWN_DEG = 20.0
TENTH = 100_000_000

_sin, _cos = np.sin(np.radians(DOWN_DEG)), np.cos(np.radians(DOWN_DEG))
#: Camera x right, y down, z forward; looks down a little, 10 cm below and before the LiDAR.
BASE_FROM_CAMERA = np.array(
    [[0, -_sin, _cos, 0.1], [-1, 0, 0, 0], [0, -_cos, -_sin, -0.1], [0, 0, 0, 1]]
)


def calibration(base_from_camera: np.ndarray = BASE_FROM_CAMERA) -> Calibration:
    """The camera `rgb` mounted so, and the LiDAR, which is the base."""
    lens = {"size": [WIDTH, HEIGHT], "fx": FOCAL, "fy": FOCAL}
    lens |= {"cx": (WIDTH - 1) / 2, "cy": (HEIGHT - 1) / 2}
    return Calibration.parse(
        {
            "lidar": {"base_from_sensor": np.eye(4).tolist()},
            "rgb": {"base_from_sensor": base_from_camera.tolist(), "camera": lens},
        }
    )


@dataclass(frozen=True)
class Thing:
    """An ellipsoid on the ground, turned about the vertical."""

    label: int
    center: np.ndarray  #: (3,) m, from the LiDAR at its start
    yaw: float
    size: np.ndarray  #: (3,) m
    speed: float = 0.0  #: m/s along its length

    def at(self, seconds: float) -> Thing:
        """Where it is then."""
        way = self.speed * seconds * np.array([np.cos(self.yaw), np.sin(self.yaw), 0])
        return replace(self, center=self.center + way)


SIZES = {
    VEHICLE: np.array([4.4, 1.9, 1.5]),
    PERSON: np.array([0.45, 0.6, 1.75]),
    BICYCLE: np.array([1.8, 0.4, 1.2]),
}


def thing(
    label: int, x: float, y: float, yaw: float, scale: float = 1.0, speed: float = 0
) -> Thing:
    """A thing of its usual size that stands on the ground."""
    size = SIZES[label] * scale
    return Thing(label, np.array([x, y, size[2] / 2 - ABOVE_GROUND_M]), yaw, size, speed)


@dataclass(frozen=True)
class Street:
    """One instant: what is true of each point, and what the sensors and networks say."""

    truth: np.ndarray  #: (n,) class of each point, 0 without a return
    cloud: Message[Cloud]  #: with the LiDAR network's scores
    scores: Message[ClassScores]
    boxes: Message[Detections]


def street(seed: int) -> Street:
    """A scene of three to nine things before a wall."""
    rng = np.random.default_rng(seed)
    wall_m = rng.uniform(14, 24)
    things = _things(rng, wall_m)
    elevation = np.radians((ROWS / 2 - 0.5 - np.arange(ROWS)) * 90 / ROWS)[:, None]
    azimuth = np.pi - (np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS
    ahead, aside = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    up = np.broadcast_to(np.sin(elevation), ahead.shape)
    rays = np.stack([ahead, aside, up], axis=-1).reshape(-1, 3)
    distance, truth, _ = cast(np.zeros(3), rays, things, wall_m)
    noisy = distance + rng.normal(0, 0.02, len(rays))
    points = np.where(truth[:, None] > 0, rays * noisy[:, None], 0).astype(np.float32)
    row, column = np.divmod(np.arange(len(rays)), COLUMNS)
    said = lidar_network(rng, truth, row // 8 * COLUMNS + column // 8)
    cloud = Cloud(points, said, truth > 0, None, "lidar", shape=(ROWS, COLUMNS))
    label, owner, _ = picture(things, wall_m)
    return Street(
        truth,
        Message.at(0, cloud),
        Message.at(0, segmentation(rng, label)),
        Message.at(0, detector(rng, owner, {k: one.label for k, one in enumerate(things)})),
    )


@dataclass(frozen=True)
class Frame:
    """One image of a flight: the truth, and what the camera and the networks say."""

    truth: np.ndarray  #: (height, width)
    scores: Message[ClassScores]
    boxes: Message[Detections]
    depth: Message[DepthImage]


def flight(
    seed: int, frames: int, forward_m_s: float
) -> tuple[list[Frame], tuple[Message[Pose], ...]]:
    """Images at 10 Hz of a street on which a person walks and a bicycle drives past a parked car;
    and the camera's poses."""
    rng = np.random.default_rng(seed)
    things = [
        thing(PERSON, 8.0, 2.5, -np.pi / 2 + rng.uniform(-0.3, 0.3), speed=1.4),
        thing(BICYCLE, 10.5, -3.5, np.pi / 2 + rng.uniform(-0.3, 0.3), speed=2.5),
        thing(VEHICLE, 13.0, rng.uniform(-3, 3), rng.uniform(0, np.pi)),
    ]
    taken, poses = [], []
    for number in range(frames):
        stamp, forward = number * TENTH, forward_m_s * number / 10
        now = [one.at(number / 10) for one in things]
        label, owner, meters = picture(now, 17.0, forward)
        noisy = meters + rng.normal(0, 1, meters.shape) * 0.003 * meters**2  # of a stereo camera
        counts = np.clip(np.where(meters < 20, noisy, 0) * 1000, 0, 65_535).astype(np.uint16)
        classes = {k: one.label for k, one in enumerate(now)}
        pose = np.eye(4)
        pose[0, 3] = forward
        poses.append(Message.at(stamp, Pose(pose)))
        taken.append(
            Frame(
                label,
                Message.at(stamp, segmentation(rng, label, noise=1.6, weak=THINGS)),
                Message.at(stamp, detector(rng, owner, classes)),
                Message.at(stamp, DepthImage(counts, 0.001, "rgb")),
            )
        )
    return taken, tuple(poses)


def picture(
    things: list[Thing], wall_m: float, forward_m: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Class, thing (-1: none) and depth (m) of each pixel (height, width)."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL
    looks = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    stretch = np.linalg.norm(looks, axis=1)
    rays = looks @ BASE_FROM_CAMERA[:3, :3].T / stretch[:, None]
    origin = BASE_FROM_CAMERA[:3, 3] + (forward_m, 0, 0)
    distance, label, owner = cast(origin, rays, things, wall_m)
    label = np.where(label == 0, SKY, label)
    seen = (label, owner, distance / stretch)
    label, owner, depth = (image.reshape(HEIGHT, WIDTH) for image in seen)
    return label, owner, depth


def cast(
    origin: np.ndarray, rays: np.ndarray, things: list[Thing], wall_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, class (0: none) and thing (-1: none) of what each ray (n, 3) of length 1 hits."""
    with np.errstate(divide="ignore", invalid="ignore"):
        down = (-ABOVE_GROUND_M - origin[2]) / rays[:, 2]
        ahead = (wall_m - origin[0]) / rays[:, 0]
    distance = np.where(down > 0, down, np.inf)
    label = np.where(down > 0, ROAD, 0)
    height = origin[2] + ahead * rays[:, 2] + ABOVE_GROUND_M
    wall = (ahead > 0) & (ahead < distance) & (height < 8)
    distance, label = np.where(wall, ahead, distance), np.where(wall, BUILDING, label)
    owner = np.full(len(rays), -1)
    for number, one in enumerate(things):
        along, across = np.cos(one.yaw), np.sin(one.yaw)
        turn = np.array([[along, -across, 0], [across, along, 0], [0, 0, 1]])
        start = (origin - one.center) @ turn / (one.size / 2)  # in its frame it is the unit ball
        toward = rays @ turn / (one.size / 2)
        a, b = (toward**2).sum(axis=1), toward @ start
        square = b**2 - a * (start @ start - 1)
        enter = (-b - np.sqrt(np.maximum(square, 0))) / a
        hit = (square > 0) & (enter > 0) & (enter < distance)
        distance = np.where(hit, enter, distance)
        label, owner = np.where(hit, one.label, label), np.where(hit, number, owner)
    far = ~(distance < 60)
    return distance, np.where(far, 0, label), np.where(far, -1, owner)


def lidar_network(rng: np.random.Generator, truth: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Log scores (n, 16) of points: half sure, and wrong about one `patch` (n,) in ten."""
    wrong = rng.random(int(patch.max()) + 1) < 0.1
    other = rng.choice([BUILDING, ROAD, VEGETATION, VEHICLE], len(wrong))
    said = np.where(wrong[patch], other[patch], truth)
    p = np.full((len(truth), 16), 0.5 / (C - 1), np.float32)
    p[np.arange(len(truth)), said] = 0.5
    log_scores = np.log(p)
    log_scores[:, C:] = PADDING_LOG
    return log_scores


def segmentation(
    rng: np.random.Generator, label: np.ndarray, noise: float = 0.4, weak: tuple[int, ...] = ()
) -> ClassScores:
    """Scores of a label image (0: nothing is known) that bleed by a cell and are noisy.

    In a third of the images a class of `weak` is hardly seen, each at its own times.
    """
    height, width = label.shape
    p = np.zeros((height, width, 16), np.float32)
    np.put_along_axis(p, label[..., None], np.float32(1), axis=-1)
    p[..., 0] = 0
    cells = (width // STRIDE, height // STRIDE)
    small = cv2.resize(p, cells, interpolation=cv2.INTER_AREA)[..., :C]
    soft = np.stack([cv2.GaussianBlur(small[..., k], (0, 0), 1.2) for k in range(C)], axis=-1)
    soft /= np.maximum(soft.sum(axis=-1, keepdims=True), 1e-3)
    for k in weak:
        soft[..., k] *= 0.05 if rng.random() < 1 / 3 else 1.0
    grid = np.full((1, *soft.shape[:2], 16), PADDING_LOG, np.float32)
    grid[0, ..., :C] = np.log(0.85 * soft + 0.01) + rng.normal(0, noise, soft.shape)
    rects = np.array([[0, 0, width, height]], np.float32)
    return ClassScores(grid, rects, 1.0, 0, "rgb", (width, height))


def detector(
    rng: np.random.Generator, owner: np.ndarray, classes: Mapping[int, int], least_pixels: int = 15
) -> Detections:
    """Boxes around what is seen of each thing: edges off by 4 % of the box, one in ten missing."""
    found = []
    for number, label in classes.items():
        rows, columns = np.nonzero(owner == number)
        if len(rows) < least_pixels or rng.random() < 0.1:
            continue
        low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()])
        slack = np.maximum(0.04 * (high - low), 0.5)
        edges = [low - slack / 2 + rng.normal(0, slack), high + slack / 2 + rng.normal(0, slack)]
        found.append((np.concatenate(edges), label, rng.uniform(0.5, 0.95)))
    return Detections(
        np.array([edges for edges, _, _ in found], np.float32).reshape(-1, 4),
        np.array([label for _, label, _ in found], np.int64),
        np.array([score for _, _, score in found], np.float32),
        "rgb",
    )


def _things(rng: np.random.Generator, wall_m: float) -> list[Thing]:
    """Cars, persons and bicycles before the wall, not within each other."""
    things: list[Thing] = []
    for _ in range(int(rng.integers(4, 10)) * 3):
        x, y = rng.uniform(6, wall_m - 1.2), rng.uniform(-7, 7)
        label = int(rng.choice(list(SIZES)))
        new = thing(label, x, y, rng.uniform(0, np.pi), rng.uniform(0.9, 1.1))
        gaps = [np.linalg.norm((new.center - one.center)[:2]) for one in things]
        reach = [(new.size[0] + one.size[0]) / 2 for one in things]
        if all(gap > least for gap, least in zip(gaps, reach, strict=True)):
            things.append(new)
        if len(things) == 9:
            break
    return things
