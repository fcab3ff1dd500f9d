"""The image fusion stage on scenes small enough to know the answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.errors import StageError
from pipeline.message import Message
from stages.fuse_image import FuseImage
from stages.fused import FusedImage, FusionStatus
from stages.types import (
    Calibration,
    ClassScores,
    DepthImage,
    Detections,
    Pose,
)

C = 15
ROAD, PERSON, VEGETATION, VEHICLE = 3, 5, 7, 13
WIDTH, HEIGHT = 80, 60
TENTH = 100_000_000
#: Camera x right, y down, z forward from a base with x forward, y left, z up.
FORWARD = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
BESIDE = [[0, 0, 1, 0], [-1, 0, 0, -0.5], [0, -1, 0, 0], [0, 0, 0, 1]]  # 0.5 m to the right
LENS = {"size": [WIDTH, HEIGHT], "fx": 60, "fy": 60, "cx": 39.5, "cy": 29.5}
CALIBRATION = Calibration.parse(
    {
        "rgb": {"base_from_sensor": FORWARD, "camera": LENS},
        "thermal": {"base_from_sensor": BESIDE, "camera": LENS},
    }
)


def scores(
    labels: np.ndarray | int, stamp: int = 0, certainty: float = 0.9, camera: str = "rgb"
) -> Message[ClassScores]:
    """An image whose pixels say their label with this probability."""
    labels = np.broadcast_to(labels, (HEIGHT, WIDTH)) if np.isscalar(labels) else labels
    height, width = labels.shape  # type: ignore[union-attr]
    p = np.full((1, height, width, 16), (1 - certainty) / (C - 1), np.float32)
    np.put_along_axis(p[0], np.asarray(labels)[..., None], np.float32(certainty), axis=-1)
    rects = np.array([[0, 0, width, height]], np.float32)
    size = (width, height)
    return Message.at(stamp, ClassScores(np.log(p), rects, 1.0, 0, camera, size))


def depth(meters: np.ndarray | float, stamp: int = 0) -> Message[DepthImage]:
    counts = np.broadcast_to(np.asarray(meters) * 1000, (HEIGHT, WIDTH)).astype(np.uint16)
    return Message.at(stamp, DepthImage(counts, 0.001, "rgb"))


def boxes(
    *found: tuple[list[float], int, float], camera: str = "rgb", stamp: int = 0
) -> Message[Detections]:
    corners, classes, strengths = zip(*found, strict=True)
    payload = Detections(
        np.array(corners, np.float32), np.array(classes), np.array(strengths, np.float32), camera
    )
    return Message.at(stamp, payload)


def drive(*forward_m: float) -> tuple[Message[Pose], ...]:
    """Poses every 0.1 s, so far forward."""
    poses = []
    for number, x in enumerate(forward_m):
        pose = np.eye(4)
        pose[0, 3] = x
        poses.append(Message.at(number * TENTH, Pose(pose)))
    return tuple(poses)


def stage(**options: Any) -> FuseImage:
    return FuseImage(calibration=CALIBRATION, probabilities=True, **options)


def every_class(fused: FusedImage) -> np.ndarray:
    assert fused.probabilities is not None
    return fused.probabilities


def test_a_camera_without_depth_gets_detections_and_says_what_is_missing() -> None:
    fuse = FuseImage()  # not even a calibration
    found = boxes(([10, 10, 30, 50], PERSON, 0.9))
    for number in range(3):
        fused = fuse.process(
            scores(ROAD, number * TENTH, 0.6), found, boxes(([0, 0, 9, 9], 5, 0.9), camera="ir")
        )
    assert fused.mask[30, 20] == PERSON
    assert fused.mask[30, 60] == ROAD
    assert fused.confidence[30, 60] == pytest.approx(0.6, abs=1e-3)
    assert fused.status == FusionStatus.NO_DEPTH | FusionStatus.BOXES_LEFT_OUT
    assert fused.smoothed == 0
    assert fused.probabilities is None
    assert fuse.statistics() == {
        "images": 3,
        "no_depth": 3,
        "first_image": 1,
        "boxes_left_out": 3,
    }


def test_a_static_pixel_follows_eq_6_from_image_to_image() -> None:
    fuse = stage()
    first = fuse.process(scores(ROAD), depth=depth(5))
    second = fuse.process(scores(VEGETATION, TENTH), depth=depth(5, TENTH))
    assert first.status == FusionStatus.FIRST_IMAGE
    assert (second.status, second.smoothed) == (0, 1.0)
    now, before = (np.full(C, 0.1 / 14), np.full(C, 0.1 / 14))
    now[VEGETATION] = before[ROAD] = 0.9
    alpha = np.where(np.isin(np.arange(C), (5, 6, 11, 12, 13)), 0.8, 0.25)
    expected = alpha * now + (1 - alpha) * before
    expected /= expected.sum()
    np.testing.assert_allclose(every_class(second)[:, 30, 40], expected, atol=2e-4)
    assert (second.mask == ROAD).all()


def test_the_past_moves_with_the_vehicle() -> None:
    """At 1 m forward of a wall at 5 m, what was 12 pixels off the center is 15 off."""
    labels = np.full((HEIGHT, WIDTH), ROAD)
    labels[:, 52:] = VEGETATION
    poses = drive(0.0, 1.0)
    fuse = stage()
    fuse.process(scores(labels), depth=depth(5), trajectory=poses)
    uncertain = scores(ROAD, TENTH, 1 / C)
    fused = fuse.process(uncertain, depth=depth(4, TENTH), trajectory=poses)
    assert fused.status == 0
    hit = every_class(fused)[VEGETATION] > 0.5
    assert not hit[:, :55].any()
    assert hit[:, 55:].mean() > 0.6  # a splat that grows leaves holes
    assert 0.5 < fused.smoothed < 1


@pytest.mark.parametrize(
    ("second", "status"),
    [
        ({"stamp": 6 * TENTH}, FusionStatus.GAP),
        ({"stamp": TENTH, "depth": None}, FusionStatus.NO_DEPTH),
        ({"stamp": TENTH, "depth": 0.0}, FusionStatus.NO_DEPTH),
        ({"stamp": TENTH, "depth": 65.0}, FusionStatus.NO_DEPTH),
        ({"stamp": 4 * TENTH, "trajectory": drive(0.0, 0.0)}, FusionStatus.NO_POSE),
    ],
)
def test_without_a_usable_past_the_present_stands_alone(
    second: dict[str, Any], status: FusionStatus
) -> None:
    fuse = stage()
    poses = second.get("trajectory", ())
    fuse.process(scores(ROAD), depth=depth(5), trajectory=poses)
    meters, stamp = second.get("depth", 5.0), second["stamp"]
    picture = None if meters is None else depth(meters, stamp)
    fused = fuse.process(scores(VEGETATION, stamp), depth=picture, trajectory=poses)
    assert fused.status == status
    assert (fused.mask == VEGETATION).all()
    np.testing.assert_allclose(every_class(fused)[VEGETATION], 0.9, atol=1e-3)


def test_another_size_drops_the_past_and_scales_the_camera() -> None:
    fuse = stage()
    fuse.process(scores(ROAD), depth=depth(5))
    half = np.full((HEIGHT // 2, WIDTH // 2), VEGETATION)
    counts = np.full(half.shape, 5000, np.uint16)
    for number, status in ((1, FusionStatus.SIZE_CHANGED), (2, FusionStatus(0))):
        stamp = number * TENTH
        picture = Message.at(stamp, DepthImage(counts, 0.001, "rgb"))
        fused = fuse.process(scores(half, stamp), depth=picture)
        assert fused.status == status
    assert fused.smoothed == 1.0


def test_smoothing_can_be_switched_off() -> None:
    fuse = stage(smooth=False)
    fuse.process(scores(ROAD), depth=depth(5))
    fused = fuse.process(scores(VEGETATION, TENTH), depth=depth(5, TENTH))
    assert (fused.mask == VEGETATION).all()
    assert fused.smoothed == 0


def test_a_box_takes_only_the_object_in_front() -> None:
    meters = np.full((HEIGHT, WIDTH), 12.0)
    meters[20:50, 30:40] = 6.0
    found = boxes(([25, 15, 45, 55], PERSON, 0.95))
    fused = stage().run_once(scores(ROAD, certainty=0.4), found, None, depth(meters))
    np.testing.assert_array_equal(fused.mask == PERSON, meters == 6)


def test_a_detection_fades_over_the_following_images() -> None:
    fuse = stage()
    found = boxes(([25, 15, 45, 55], PERSON, 0.99))
    seen = [
        float(
            every_class(fuse.process(scores(ROAD, n * TENTH, 0.9), f, None, depth(6, n * TENTH)))[
                PERSON, 35, 35
            ]
        )
        for n, f in enumerate((found, None, None, None))
    ]
    assert seen[0] > 0.8
    assert seen == sorted(seen, reverse=True)
    assert seen[1] > 0.1 > seen[3]


def test_a_thermal_box_is_carried_over_by_depth_and_skips_pixels_without() -> None:
    """Seen from 0.5 m to the right, a person at 6 m stands 5 pixels further left."""
    meters = np.full((HEIGHT, WIDTH), 12.0)
    meters[20:50, 30:40] = 6.0
    meters[20:22, 30:40] = 0.0
    warm = boxes(([24, 18, 36, 51], PERSON, 0.95), camera="thermal")
    fused = stage().run_once(scores(ROAD, certainty=0.4), None, warm, depth(meters))
    np.testing.assert_array_equal(fused.mask == PERSON, meters == 6)


def test_a_thermal_box_is_placed_from_where_its_camera_was_at_its_own_stamp() -> None:
    """The thermal image was taken 0.1 s later, 1 m nearer."""
    meters = np.full((HEIGHT, WIDTH), 12.0)
    meters[20:50, 30:40] = 6.0
    # At 5 m, 0.5 m to the right: u' = 39.5 + 60 * ((u - 39.5) / 60 * 6 - 0.5) / 5.
    edges = [39.5 + 60 * ((u - 39.5) / 10 - 0.5) / 5 for u in (29.5, 39.5)]
    warm = boxes(([edges[0], 15, edges[1], 55], PERSON, 0.95), camera="thermal", stamp=TENTH)
    fused = stage().run_once(
        scores(ROAD, certainty=0.4), None, warm, depth(meters), drive(0.0, 1.0)
    )
    np.testing.assert_array_equal(fused.mask == PERSON, meters == 6)


def test_each_camera_has_its_own_past() -> None:
    fuse = FuseImage()
    fuse.process(scores(ROAD))
    assert FusionStatus.FIRST_IMAGE in fuse.process(scores(ROAD, 1, camera="other")).status
    assert FusionStatus.FIRST_IMAGE not in fuse.process(scores(ROAD, 2)).status


def test_results_do_not_depend_on_whether_probabilities_are_published() -> None:
    rng = np.random.default_rng(5)
    published, reused = stage(), FuseImage(calibration=CALIBRATION)
    kept = []
    for number in range(5):
        labels = rng.integers(0, C, (HEIGHT, WIDTH))
        inputs = scores(labels, number * TENTH, 0.7), None, None, depth(5, number * TENTH)
        one, other = published.process(*inputs), reused.process(*inputs)
        np.testing.assert_array_equal(one.mask, other.mask)
        np.testing.assert_array_equal(one.confidence, other.confidence)
        kept.append((every_class(one), every_class(one).copy()))
    for shown, copy in kept:  # a message's payload is never written again
        np.testing.assert_array_equal(shown, copy)
        assert not shown.flags.writeable


def test_wiring_mistakes_are_said() -> None:
    other = Message.at(0, DepthImage(np.zeros((HEIGHT, WIDTH), np.uint16), 0.001, "left"))
    with pytest.raises(StageError, match=r"depth of 'left'.*give depth aligned"):
        stage().process(scores(ROAD), depth=other)
    small = Message.at(0, DepthImage(np.zeros((4, 4), np.uint16), 0.001, "rgb"))
    with pytest.raises(StageError, match=r"depth of 'rgb' \(4, 4\)"):
        stage().process(scores(ROAD), depth=small)
    with pytest.raises(StageError, match=r"class 15 is none of the taxonomy's 0\.\.14"):
        stage().process(scores(ROAD), boxes(([0, 0, 9, 9], 15, 0.5)))
    square = np.full((HEIGHT, HEIGHT), ROAD)
    picture = DepthImage(np.full(square.shape, 5000, np.uint16), 0.001, "rgb")
    with pytest.raises(StageError, match="its calibration says"):
        stage().process(scores(square), depth=Message.at(0, picture))
    narrow = ClassScores(
        np.zeros((1, 2, 2, 15), np.float32),
        np.zeros((1, 4), np.float32),
        1,
        0,
        "rgb",
        (2, 2),
    )
    with pytest.raises(StageError, match=r"give \(tiles, rows, columns, 16\)"):
        stage().process(Message.at(0, narrow))


@pytest.mark.parametrize(
    "options",
    [
        {"share_dynamic": 0.0},
        {"share_static": 1.5},
        {"max_gap_s": 0.0},
        {"growth": float("nan")},
        {"depth_m": (5.0, 1.0)},
    ],
)
def test_wrong_options_are_said(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        FuseImage(**options)


ODD = (np.nan, np.inf, -np.inf, 1e30, -1e30, 0.0, 3.0)


def odd_inputs(rng: np.random.Generator, width: int, height: int, stamp: int) -> dict[str, Any]:
    """Scores, boxes, depth and poses with whatever may go wrong in them."""
    tiles, rows, columns = rng.integers(0, 3), rng.integers(0, 3), rng.integers(0, 3)
    grid = rng.normal(0, 3, (tiles, rows, columns, 16)).astype(np.float32)
    grid[rng.random(grid.shape) < 0.05 * rng.integers(0, 2)] = rng.choice(ODD)
    rects = np.tile(np.array([0, 0, width, height], np.float32), (tiles, 1))
    rects[rng.random(rects.shape) < 0.1] = rng.choice(ODD)

    def found(camera: str) -> Message[Detections]:
        n = int(rng.integers(0, 4))
        corners = rng.uniform(-5, 40, (n, 4)).astype(np.float32)
        corners[rng.random(corners.shape) < 0.1] = rng.choice(ODD)
        strengths = rng.uniform(-0.5, 1.5, n).astype(np.float32)
        strengths[rng.random(n) < 0.1] = rng.choice(ODD)
        payload = Detections(corners, rng.integers(0, C, n), strengths, camera)
        return Message.at(stamp, payload)

    counts = rng.integers(0, 20_000, (height, width)).astype(np.uint16)
    counts[rng.random(counts.shape) < rng.choice((0.0, 0.5, 1.0))] = rng.choice((0, 1, 65535, 5000))
    pose = np.eye(4)
    pose[:3, 3] = rng.uniform(-20, 20, 3)
    if rng.random() < 0.1:
        pose[rng.integers(0, 3), rng.integers(0, 4)] = rng.choice(ODD)
    early = int(rng.choice((0, 0, 0, -4 * TENTH)))  # poses that end before the image
    poses = tuple(
        Message.at(stamp + early + after, Pose(matrix))
        for after, matrix in ((0, np.eye(4)), (TENTH, pose))
    )
    image = ClassScores(grid, rects, 1.0, 0, "rgb", (width, height))
    return {
        "scores": Message.at(stamp, image),
        "boxes": found("rgb"),
        "thermal": found("thermal"),
        "depth": Message.at(stamp, DepthImage(counts, 0.001, "rgb")),
        "trajectory": poses,
    }


@pytest.mark.slow
def test_ten_thousand_odd_inputs_give_probabilities_and_flags_never_an_exception() -> None:
    rng = np.random.default_rng(7)
    fuse = stage(depth_m=(0.0, 60.0))
    flags = FusionStatus(0)
    stamp = 0
    for _ in range(10_000):
        factor = int(rng.choice((1, 2, 4, 20)))
        width, height = WIDTH // factor // 2, HEIGHT // factor // 2
        stamp += int(rng.choice((1, TENTH, 10 * TENTH)))
        inputs = odd_inputs(rng, width, height, stamp)
        for name in ("boxes", "thermal", "depth"):
            if rng.random() < 0.1:
                inputs[name] = None
        with np.errstate(all="ignore"):
            fused = fuse.process(**inputs)
        p = every_class(fused)
        assert np.isfinite(p).all()
        assert (p >= 0).all()
        np.testing.assert_allclose(p.sum(axis=0), 1.0, atol=1e-5)
        np.testing.assert_array_equal(fused.mask, p.argmax(axis=0))
        np.testing.assert_array_equal(fused.confidence, p.max(axis=0))
        flags |= fused.status
        spoiled = inputs["boxes"] and not np.isfinite(inputs["boxes"].payload.boxes).all()
        assert not spoiled or FusionStatus.SPOILED_BOXES in fused.status
    assert flags == FusionStatus((1 << len(FusionStatus)) - 1)


@pytest.mark.parametrize("size", [(0, 0), (0, 5), (1, 1), (1, 9)])
def test_images_of_no_or_one_pixel_pass(size: tuple[int, int]) -> None:
    labels = np.full(size[::-1], ROAD)
    fused = FuseImage().run_once(scores(labels), boxes(([0, 0, 9, 9], PERSON, 0.9)))
    assert fused.mask.shape == size[::-1]


def scenario(frames: int) -> list[tuple[np.ndarray, np.ndarray, tuple[float, float, float, float]]]:
    """A person walks in front of a wall while the camera moves forward: truth, depth, box.

    A quarter of the pixels says a random class, a third of the person's says vegetation.
    """
    sequence = []
    for number in range(frames):
        wall, person = 10 - 0.05 * number, 5 - 0.05 * number
        truth = np.full((HEIGHT, WIDTH), VEGETATION)
        truth[HEIGHT // 2 :] = ROAD
        meters = np.full((HEIGHT, WIDTH), wall)
        left, right = (39.5 + 60 * (x + 0.08 * number) / person for x in (-1.2, -0.6))
        top, bottom = (29.5 + 60 * y / person for y in (-0.8, 1.0))
        window = np.s_[round(top) : round(bottom), round(left) : round(right)]
        truth[window], meters[window] = PERSON, person
        sequence.append((truth, meters, (left - 1, top - 1, right + 1, bottom + 1)))
    return sequence


def run_scenario(smooth: bool) -> tuple[float, float, float]:
    """Flips per static pixel and image, person IoU of the raw masks and of the fused ones."""
    rng = np.random.default_rng(11)
    fuse = FuseImage(calibration=CALIBRATION, smooth=smooth)
    poses = drive(*(0.05 * number for number in range(21)))
    flips, static, previous = 0, 0, None
    hits = np.zeros((2, 2))  # (raw, fused) x (intersection, union)
    for number, (truth, meters, corners) in enumerate(scenario(20)):
        said = np.where(rng.random(truth.shape) < 0.25, rng.integers(0, C, truth.shape), truth)
        noisy = np.where((truth == PERSON) & (rng.random(truth.shape) < 0.3), VEGETATION, said)
        stamp = number * TENTH
        found = boxes((list(corners), PERSON, 0.8), stamp=stamp)
        fused = fuse.process(scores(noisy, stamp, 0.6), found, None, depth(meters, stamp), poses)
        for row, mask in enumerate((noisy, fused.mask)):
            hits[row] += (
                ((mask == PERSON) & (truth == PERSON)).sum(),
                ((mask == PERSON) | (truth == PERSON)).sum(),
            )
        if previous is not None:
            stays = (truth != PERSON) & (truth == previous[0])
            flips += int((fused.mask != previous[1])[stays].sum())
            static += int(stays.sum())
        previous = truth, fused.mask
    raw, after = hits[:, 0] / hits[:, 1]
    return flips / static, float(raw), float(after)


def test_smoothing_calms_static_pixels_and_fusion_finds_the_person_better() -> None:
    """Flips 0.17 against 0.41; IoU of the person 0.37 raw, 0.58 with boxes, 0.69 smoothed too."""
    on, off = run_scenario(smooth=True), run_scenario(smooth=False)
    assert on[0] < 0.5 * off[0]
    assert off[2] > off[1] + 0.15
    assert on[2] > off[2] + 0.05
