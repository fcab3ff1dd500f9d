"""The fusion stage on scenes small enough to know the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import DataError, StageError
from pipeline.message import Message
from stages.fuse_cloud import FuseCloud
from stages.kernels.foreground import points_in_box
from stages.kernels.geometry import deskew
from stages.kernels.probability import accumulate, add_detection, bound_rows, softmax
from stages.kernels.projection import project
from stages.kernels.sampling import sample_scores
from stages.types import (
    PADDING_LOG,
    Calibration,
    ClassScores,
    Cloud,
    Detections,
    Pose,
    Scan,
)

C = 15
ROAD, PERSON, VEHICLE = 3, 5, 13
SECOND = 1_000_000_000
#: Camera x right, y down, z forward from a base with x forward, y left, z up.
FORWARD = [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
CALIBRATION = Calibration.parse(
    {
        "lidar": {"base_from_sensor": np.eye(4).tolist()},
        "rgb": {
            "base_from_sensor": FORWARD,
            "camera": {"size": [100, 80], "fx": 50, "fy": 50, "cx": 50, "cy": 40},
        },
    }
)
#: In view straight ahead, in view up left, behind, no return.
POINTS = np.array([[10, 0, 0], [10, 5, 5], [-10, 0, 0], [0, 0, 0]], np.float32)


def scan(points: np.ndarray = POINTS, times_ns: np.ndarray | None = None) -> Message[Scan]:
    return Message.at(SECOND, Scan(points, None, times_ns, None, "lidar"))


def halves(left: int, right: int, stamp: int = SECOND) -> Message[ClassScores]:
    """An image whose left half says one class and whose right half (from u = 50) another."""
    grid = np.zeros((1, 80, 100, 16), np.float32)
    grid[0, :, :50, left] = grid[0, :, 50:, right] = 4.0
    rects = np.array([[0, 0, 100, 80]], np.float32)
    return Message.at(stamp, ClassScores(grid, rects, 1.0, 0, "rgb", (100, 80)))


def boxes(*found: tuple[list[float], int, float]) -> Message[Detections]:
    corners, classes, scores = zip(*found, strict=True)
    payload = Detections(
        np.array(corners, np.float32), np.array(classes), np.array(scores, np.float32), "rgb"
    )
    return Message.at(SECOND, payload)


def forward_at(speed_m_s: float) -> tuple[Message[Pose], ...]:
    poses = []
    for stamp in (0, SECOND, 2 * SECOND):
        pose = np.eye(4)
        pose[0, 3] = speed_m_s * stamp / SECOND
        poses.append(Message.at(stamp, Pose(pose)))
    return tuple(poses)


def posterior(cloud: Cloud) -> np.ndarray:
    return softmax(cloud.log_scores, C)


def test_points_in_view_take_the_image_s_class_and_the_rest_stays_unlabeled() -> None:
    cloud = FuseCloud(calibration=CALIBRATION).run_once(scan(), (halves(ROAD, VEHICLE),))
    assert cloud.evidence.tolist() == [True, True, False, False]
    assert posterior(cloud).argmax(axis=1).tolist() == [VEHICLE, ROAD, 0, 0]
    assert posterior(cloud)[0, VEHICLE] == pytest.approx(np.exp(4) / (np.exp(4) + 14), rel=1e-5)
    assert (cloud.log_scores[:, C:] == PADDING_LOG).all()
    assert cloud.map_from_sensor is None


def test_a_scored_cloud_and_an_image_fuse_by_eq_2_and_3() -> None:
    rng = np.random.default_rng(0)
    lidar = rng.normal(size=(4, 16)).astype(np.float32)
    scored = Cloud(POINTS, lidar, np.array([True, True, True, False]), None, "lidar")
    image = halves(ROAD, VEHICLE)
    cloud = FuseCloud(calibration=CALIBRATION).process(Message.at(SECOND, scored), (image,))

    from_image = softmax(image.payload.grid[0, 0, [75, 25]], C).astype(np.float64)
    product = from_image * softmax(lidar[:2], C)
    expected = product / product.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(posterior(cloud)[:2], expected, atol=1e-6)
    np.testing.assert_allclose(posterior(cloud)[2], softmax(lidar[2], C), atol=1e-6)
    assert cloud.evidence.tolist() == [True, True, True, False]
    np.testing.assert_array_equal(scored.log_scores, lidar)  # the input is shared: not written


def test_the_order_of_the_sources_does_not_matter() -> None:
    images = (halves(ROAD, VEHICLE), halves(PERSON, ROAD))
    stage = FuseCloud(calibration=CALIBRATION)
    one, other = stage.process(scan(), images), stage.process(scan(), images[::-1])
    np.testing.assert_allclose(posterior(one), posterior(other), atol=1e-6)


#: One camera above the other, 20 deg up and 20 deg down, 77 deg high each: they share 37 deg.
STACKED = Calibration.parse(
    {
        "lidar": {"base_from_sensor": np.eye(4).tolist()},
        **{
            name: {
                "base_from_sensor": {
                    "translation": [0.1, 0, z],
                    "rotation_rpy_deg": [roll, 0, -90],
                },
                "camera": {"size": [100, 80], "fx": 50, "fy": 50, "cx": 50, "cy": 40},
            }
            for name, z, roll in (("upper", 0.02, -70), ("lower", -0.02, -110))
        },
    }
)


def stacked_inputs() -> dict[str, tuple[Message[ClassScores], Message[Detections]]]:
    """What each camera says of its whole image, and a person ahead of both, by camera."""
    inputs = {}
    for name, label in (("upper", VEHICLE), ("lower", ROAD)):
        image = halves(label, label)
        scores = replace(image.payload, camera=name)
        row = 22 if name == "lower" else 58  # 20 deg off the axis
        found = boxes(([45, row - 4, 55, row + 4], PERSON, 0.7))
        inputs[name] = (
            Message.at(SECOND, scores),
            Message.at(SECOND, replace(found.payload, camera=name)),
        )
    return inputs


def test_points_that_two_stacked_cameras_see_get_both_votes() -> None:
    level, high, low, behind = [10, 0, 0], [10, 3, 6], [10, 3, -6], [-10, 0, 0]
    cloud = scan(np.array([level, high, low, behind], np.float32))
    inputs = stacked_inputs()
    images = tuple(inputs[name][0] for name in ("upper", "lower"))
    found = tuple(inputs[name][1] for name in ("upper", "lower"))
    fused = FuseCloud(calibration=STACKED).run_once(cloud, images, found)
    assert fused.voted is not None
    # Bits: 1 and 2 the images, 3 and 4 the boxes, in the order of the edges.
    assert fused.voted.tolist() == [0b11110, 0b00010, 0b00100, 0]
    assert fused.evidence.tolist() == [True, True, True, False]
    both = posterior(fused)[0]
    one = softmax(np.eye(16)[None, VEHICLE] * 4.0, C) * softmax(np.eye(16)[None, ROAD] * 4.0, C)
    for _ in found:  # eq 4 at a box's center, twice: the cameras are two witnesses
        said = np.full(C, (1 - 0.7) / (C - 1))
        said[PERSON] = 0.7
        one = one * said
    np.testing.assert_allclose(both, (one / one.sum())[0], atol=0.02)
    assert posterior(fused).argmax(axis=1).tolist()[:3] == [PERSON, VEHICLE, ROAD]


def test_the_order_of_two_cameras_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    points = (rng.normal(size=(3_000, 3)) * (8, 6, 4) + (8, 0, 0)).astype(np.float32)
    scored = Cloud(
        points, rng.normal(size=(3_000, 16)).astype(np.float32), np.ones(3_000, bool), None, "lidar"
    )
    inputs = stacked_inputs()
    stage = FuseCloud(calibration=STACKED)
    results = []
    for order in (("upper", "lower"), ("lower", "upper")):
        images = tuple(inputs[name][0] for name in order)
        found = tuple(inputs[name][1] for name in order)
        results.append(stage.process(Message.at(SECOND, scored), images, found))
    one, other = results
    np.testing.assert_allclose(posterior(one), posterior(other), atol=1e-6)
    assert one.voted is not None
    assert other.voted is not None
    swapped = np.array([0, 2, 1, 4, 3])  # the bit of each edge in the other order
    expected = sum(((one.voted >> bit) & 1) << swapped[bit] for bit in range(5))
    np.testing.assert_array_equal(other.voted, expected)
    assert {0b00111, 0b00011, 0b00101, 0b00001} <= set(np.unique(one.voted).tolist())


def test_a_missing_image_is_no_evidence() -> None:
    cloud = FuseCloud(calibration=CALIBRATION).run_once(scan(), (None,), (None,))
    assert not cloud.evidence.any()


def test_the_camera_sees_the_scan_from_where_it_was_at_its_own_stamp() -> None:
    """At 10 m/s an image 0.5 s later was taken 5 m nearer: the point appears farther out."""
    point = np.array([[10, 2, 0]], np.float32)  # u = 40 at 10 m, u = 30 at 5 m
    grid = np.zeros((1, 80, 100, 16), np.float32)
    grid[0, :, :35, PERSON] = grid[0, :, 35:, ROAD] = 4.0
    rects = np.array([[0, 0, 100, 80]], np.float32)
    late = Message.at(SECOND + SECOND // 2, ClassScores(grid, rects, 1.0, 0, "rgb", (100, 80)))
    stage = FuseCloud(calibration=CALIBRATION)
    moving = stage.process(scan(point), (late,), (), forward_at(10.0))
    assert posterior(moving).argmax() == PERSON
    assert moving.map_from_sensor is not None
    assert moving.map_from_sensor[:3, 3].tolist() == [10, 0, 0]
    standing = stage.process(scan(point), (late,), (), forward_at(0.0))
    assert posterior(standing).argmax() == ROAD


def test_a_sweep_is_moved_into_the_frame_at_its_stamp() -> None:
    times = np.array([-50_000_000, 0, 50_000_000, 0], np.int32)
    points = np.array([[10, 0, 0]] * 4, np.float32)
    cloud = FuseCloud(calibration=CALIBRATION).run_once(
        scan(points, times), (), (), forward_at(10.0)
    )
    np.testing.assert_allclose(cloud.points[:, 0], [9.5, 10, 10.5, 10], atol=1e-5)


def test_an_instant_without_a_pose_is_left_out_and_counted() -> None:
    stage = FuseCloud(calibration=CALIBRATION)
    late = halves(ROAD, VEHICLE, stamp=2 * SECOND + 100_000_001)
    cloud = stage.process(scan(), (late,), (), forward_at(1.0))
    assert not cloud.evidence.any()
    assert cloud.map_from_sensor is not None
    assert stage.statistics()["stamps_without_pose"] == 1


def test_what_a_nearer_point_hides_gets_no_image_evidence() -> None:
    car, behind, above = [5.0, 0, 0], [12.0, 0, -0.2], [12.0, 0, 2.0]  # in one column of pixels
    points = np.array([car, behind, above], np.float32)
    image = halves(ROAD, VEHICLE)
    plain = FuseCloud(calibration=CALIBRATION).process(scan(points), (image,))
    assert plain.evidence.tolist() == [True, True, True]
    stage = FuseCloud(calibration=CALIBRATION, occlusion_deg=3.0)
    cloud = stage.process(scan(points), (image, image), (boxes(([40, 0, 60, 80], PERSON, 0.9)),))
    assert cloud.evidence.tolist() == [True, False, True]
    counted = stage.statistics()
    assert counted["points_hidden"] == 1  # one view serves all that was taken at its instant
    assert (counted["points"], counted["points_with_evidence"]) == (3, 2)


def test_a_box_claims_its_foreground_by_eq_4() -> None:
    person, wall, aside = [5.0, 0, 0], [9.0, 0, 0], [5.0, 3, 0]
    cloud = FuseCloud(calibration=CALIBRATION).run_once(
        scan(np.array([person, wall, aside], np.float32)),
        (),
        (boxes(([40, 20, 60, 60], PERSON, 0.8)),),
    )
    assert cloud.evidence.tolist() == [True, False, False]
    expected = np.full(C, 0.2 / (C - 1))
    expected[PERSON] = 0.8
    np.testing.assert_allclose(posterior(cloud)[0], expected, atol=1e-6)


def test_of_overlapping_boxes_of_a_class_only_the_strongest_counts() -> None:
    def fused(*found: tuple[list[float], int, float]) -> np.ndarray:
        stage = FuseCloud(calibration=CALIBRATION)
        return posterior(stage.process(scan(POINTS[:1]), (), (boxes(*found),)))[0]

    strong, weak = ([40, 20, 60, 60], PERSON, 0.8), ([40, 20, 60, 60], PERSON, 0.4)
    np.testing.assert_array_equal(fused(weak, strong), fused(strong))
    other = ([40, 20, 60, 60], VEHICLE, 0.6)
    assert fused(strong, other)[VEHICLE] > fused(strong)[VEHICLE]


def test_spoiled_scores_are_no_evidence_and_counted() -> None:
    image = halves(ROAD, VEHICLE)
    image.payload.grid[...] = np.nan
    stage = FuseCloud(calibration=CALIBRATION)
    cloud = stage.process(scan(), (image,))
    np.testing.assert_allclose(posterior(cloud), 1 / C, atol=1e-6)
    assert not cloud.evidence.any()
    assert stage.statistics()["points_with_unsound_image_scores"] == 2


def test_a_ray_without_a_return_is_no_point_however_fast_the_vehicle_moves() -> None:
    times = np.full(len(POINTS), 50_000_000, np.int32)  # 50 ms after the stamp: 2 m at 40 m/s
    times[0] = 0
    image = halves(ROAD, VEHICLE)
    cloud = FuseCloud(calibration=CALIBRATION).process(
        scan(POINTS, times), (image,), (), forward_at(40.0)
    )
    assert cloud.points.any(axis=1).tolist() == [True, True, True, False]
    assert not cloud.evidence[3]


@pytest.mark.parametrize("points", [np.zeros((0, 3), np.float32), np.zeros((5, 3), np.float32)])
def test_an_empty_scan_fuses_to_an_empty_or_unlabeled_cloud(points: np.ndarray) -> None:
    times = np.zeros(len(points), np.int32)
    found = boxes(([0, 0, 100, 80], PERSON, 0.8))
    stage = FuseCloud(calibration=CALIBRATION)
    image = halves(ROAD, VEHICLE)
    cloud = stage.run_once(scan(points, times), (image,), (found,), forward_at(1.0))
    assert len(cloud.points) == len(cloud.log_scores) == len(points)
    assert not cloud.evidence.any()


def test_what_stands_behind_a_box_s_object_loses_the_class_that_bled_onto_it() -> None:
    person, wall = [5.0, 0, 0], [9.0, 0, 0]
    image = halves(ROAD, PERSON)  # the whole middle says person
    lidar = np.zeros((2, 16), np.float32)
    lidar[:, 1] = 2.0  # and the LiDAR building
    cloud = Cloud(np.array([person, wall], np.float32), lidar, np.ones(2, bool), None, "lidar")
    stage = FuseCloud(calibration=CALIBRATION)
    fused = stage.run_once(
        Message.at(SECOND, cloud), (image,), (boxes(([40, 20, 60, 60], PERSON, 0.8)),)
    )
    assert posterior(fused).argmax(axis=1).tolist() == [PERSON, 1]
    assert fused.voted is not None
    assert fused.voted.tolist() == [0b111, 0b001]


@pytest.mark.parametrize(
    ("foreground", "claimed"),
    [("cluster", [True, False, False]), ("depth", [True, True, False]), ("box", [True] * 3)],
)
def test_the_object_in_a_box_is_a_cluster_a_slice_of_depth_or_all(
    foreground: str, claimed: list[bool]
) -> None:
    points = np.array([[5.0, 0, 0], [5.5, 0, 0], [9.0, 0, 0]], np.float32)
    stage = FuseCloud(calibration=CALIBRATION, foreground=foreground)  # type: ignore[arg-type]
    for shape in (None, (1, 3)):
        payload = Scan(points, None, None, shape, "lidar")
        found = boxes(([40, 20, 60, 60], PERSON, 0.8))
        fused = stage.run_once(Message.at(SECOND, payload), (), (found,))
        assert fused.evidence.tolist() == claimed


def test_payloads_of_a_wrong_shape_or_class_are_refused_before_the_kernels() -> None:
    stage = FuseCloud(calibration=CALIBRATION)
    rects = np.array([[0, 0, 100, 80]], np.float32)
    thin = ClassScores(np.zeros((1, 4, 4, 12), np.float32), rects, 1.0, 0, "rgb", (100, 80))
    with pytest.raises(StageError, match=r"scores of 'rgb': grid of shape \(1, 4, 4, 12\)"):
        stage.process(scan(), (Message.at(SECOND, thin),))
    with pytest.raises(StageError, match="class 15 is none of the taxonomy's"):
        stage.process(scan(), (), (boxes(([0, 0, 9, 9], 15, 0.5)),))
    short = Cloud(POINTS, np.zeros((2, 16), np.float32), np.ones(4, bool), None, "lidar")
    with pytest.raises(StageError, match=r"log_scores of shape \(2, 16\) for 4 points"):
        stage.process(Message.at(SECOND, short))


def test_mistakes_in_options_and_sensors_are_said() -> None:
    with pytest.raises(ValueError, match="min_range_m must be at least 0, not -1"):
        FuseCloud(calibration=CALIBRATION, min_range_m=-1.0)
    with pytest.raises(ValueError, match="foreground_m must be at least 0, not nan"):
        FuseCloud(calibration=CALIBRATION, foreground_m=float("nan"))
    with pytest.raises(ValueError, match="occlusion_deg must be at least 0 and below 45, not 90"):
        FuseCloud(calibration=CALIBRATION, occlusion_deg=90.0)
    image = halves(ROAD, VEHICLE)
    with pytest.raises(DataError, match=r"no calibration for sensor 'rgb' \(known: none\)"):
        FuseCloud(calibration=Calibration()).run_once(scan(), (image,))


@pytest.mark.parametrize("writeable", [True, False])
def test_after_open_no_scan_waits_for_a_compiler(writeable: bool) -> None:
    stage = FuseCloud(calibration=CALIBRATION)
    stage.open()
    kernels = (project, sample_scores, accumulate, add_detection, deskew, points_in_box, bound_rows)
    compiled = [len(kernel.signatures) for kernel in kernels]
    image, found = halves(ROAD, VEHICLE), boxes(([0, 0, 100, 80], PERSON, 0.8))
    sweep = scan(POINTS.copy(), np.zeros(4, np.int32))
    for payload in (image.payload, found.payload, sweep.payload):
        for array in (getattr(payload, name) for name in payload.__dataclass_fields__):
            if isinstance(array, np.ndarray):
                array.flags.writeable = writeable
    stage.process(sweep, (image,), (found,), forward_at(1.0))
    assert [len(kernel.signatures) for kernel in kernels] == compiled
