"""The tiny flight: the same for the same seed, true to its truth, with enough of every class."""

from __future__ import annotations

import hashlib
from collections import Counter

import numpy as np
import pytest

from stages.kernels.geometry import invert
from stages.kernels.projection import fold_limit, project
from stages.labels import Labels
from stages.simulation.simulation import Sample, Simulation
from stages.taxonomy import load_taxonomy
from stages.types import DepthImage, Detections, Image, Pose, Scan

TAXONOMY = load_taxonomy()

#: sha256 over the classes of every pixel and return of the tiny flight. A change of the generator
#: changes it: look at the pictures, then write the new one here.
FLIGHT = "0afa2579677b0ba0"


def of(samples: list[Sample], topic: str) -> list[Sample]:
    return [sample for sample in samples if sample.topic == topic]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_flight(samples: list[Sample]) -> None:
    digest = hashlib.sha256()
    for sample in samples:
        if isinstance(sample.message.payload, Labels):
            digest.update(sample.message.payload.classes.tobytes())
    assert digest.hexdigest()[:16] == FLIGHT


@pytest.mark.slow
def test_a_sample_does_not_depend_on_what_was_made_before(
    tiny: Simulation, samples: list[Sample]
) -> None:
    turn = next(turn for turn in reversed(tiny.exposures()) if turn.sensor == "rgb")
    again = next(iter(tiny.take(turn))).message.payload
    before = of(samples, "rgb")[-1].message.payload
    assert isinstance(again, Image)
    assert np.array_equal(again.data, before.data)


@pytest.mark.slow
def test_every_class_that_networks_learn_has_support(samples: list[Sample]) -> None:
    pixels, returns = Counter[str](), Counter[str]()
    for topic, counts in (
        ("truth/rgb", pixels),
        ("truth/rgb_lower", pixels),
        ("truth/lidar", returns),
    ):
        for sample in of(samples, topic):
            classes = sample.message.payload.classes
            for kind, count in enumerate(np.bincount(classes.ravel(), minlength=len(TAXONOMY))):
                counts[TAXONOMY.names[kind]] += count / classes.size / len(of(samples, topic))
    least = {"building": 0.02, "road": 0.05, "sidewalk": 0.02, "vegetation": 0.02}
    least |= {"person": 0.001, "bicycle": 0.0005, "vehicle": 0.01, "object": 0.001}
    assert {name: pixels[name] for name in least if pixels[name] < least[name]} == {}
    assert {name: returns[name] for name in least if returns[name] < least[name] / 3} == {}
    assert pixels["sky"] > 0.02
    assert max(pixels.values()) < 1.3  # of two cameras' 2.0: no class is nearly all there is


@pytest.mark.slow
def test_depth_lies_on_what_the_lidar_measures(tiny: Simulation, samples: list[Sample]) -> None:
    """Two sensors, two poses, one world: LiDAR points carried into the camera have its depth."""
    scan, depth = of(samples, "lidar")[1].message, None
    flight, rig = tiny.district.flight, tiny.rig
    payload = scan.payload
    assert isinstance(payload, Scan)
    assert payload.times_ns is not None
    nearest = min(of(samples, "rgb/depth"), key=lambda s: abs(s.message.stamp - scan.stamp))
    depth = nearest.message.payload
    assert isinstance(depth, DepthImage)
    seen = np.linalg.norm(payload.points, axis=1) > 1.0
    poses = flight.at(scan.stamp + payload.times_ns[seen])
    sensor = poses @ rig.sensors["lidar"].calibration.base_from_sensor
    world = (sensor[:, :3, :3] @ payload.points[seen][..., None])[..., 0] + sensor[:, :3, 3]
    calibration = rig.sensors["rgb"].calibration
    camera = calibration.camera
    assert camera is not None
    at = flight.at(np.array([nearest.message.stamp]))[0] @ calibration.base_from_sensor
    intrinsics = camera.intrinsics()
    index, pixel, _ = project(
        world.astype(np.float32),
        np.ones(len(world), dtype=np.bool_),
        invert(at),
        intrinsics,
        *camera.size,
        fold_limit(intrinsics),
    )
    z = (invert(at)[:3, :3] @ world[index].T + invert(at)[:3, 3:])[2]
    u, v = np.round(pixel).astype(int).T
    u, v = u.clip(0, camera.size[0] - 1), v.clip(0, camera.size[1] - 1)
    measured = depth.depth[v, u] * depth.unit_m
    both = measured > 0
    assert both.sum() > 300
    error = np.abs(measured - z)[both] / z[both]
    assert np.median(error) < 0.02


@pytest.mark.slow
def test_a_pixel_that_lies_in_no_box_is_of_no_boxed_class_or_tiny(samples: list[Sample]) -> None:
    for labels, boxes in zip(of(samples, "truth/rgb"), of(samples, "truth/rgb/boxes"), strict=True):
        found = boxes.message.payload
        assert isinstance(found, Detections)
        covered = np.zeros(labels.message.payload.classes.shape, dtype=bool)
        for x0, y0, x1, y1 in found.boxes.astype(int):
            covered[y0 : y1 + 1, x0 : x1 + 1] = True
        person = labels.message.payload.classes == TAXONOMY.id("person")
        stray = np.unique(labels.message.payload.instances[person & ~covered], return_counts=True)
        assert (stray[1] < 24).all()


@pytest.mark.slow
def test_every_topic_comes_at_its_rate_in_the_order_of_arrival(samples: list[Sample]) -> None:
    received = [sample.message.received for sample in samples]
    assert received == sorted(received)
    for topic, count in (("rgb", 5), ("rgb_lower/depth", 5), ("thermal", 5), ("lidar", 4)):
        stamps = [sample.message.stamp for sample in of(samples, topic)]
        assert len(stamps) == count
        assert np.diff(stamps) == pytest.approx(2e8)


@pytest.mark.slow
def test_a_scan_is_stamped_mid_sweep_and_its_columns_run_over_the_sweep(
    samples: list[Sample],
) -> None:
    message = of(samples, "lidar")[0].message
    scan = message.payload
    assert isinstance(scan, Scan)
    assert scan.times_ns is not None
    assert (message.begin, message.stamp, message.end) == (0, 100_000_000, 200_000_000)
    assert scan.times_ns.min() >= message.begin - message.stamp
    assert scan.times_ns.max() <= message.end - message.stamp
    assert scan.times_ns.mean() == pytest.approx(0.0, abs=1e3)


@pytest.mark.slow
def test_thermal_shows_persons_warmer_than_the_street(samples: list[Sample]) -> None:
    warm, street = [], []
    for image, labels in zip(of(samples, "thermal"), of(samples, "truth/thermal"), strict=True):
        data, classes = image.message.payload.data, labels.message.payload.classes
        assert data.dtype == np.uint16
        warm.append(data[classes == TAXONOMY.id("person")])
        street.append(data[classes == TAXONOMY.id("road")])
    difference = np.concatenate(warm).mean() - np.concatenate(street).mean()
    assert 150 < difference < 1500  # of 0.01 K


@pytest.mark.slow
def test_clock_offsets_and_pose_noise_are_as_asked(tiny: Simulation) -> None:
    """A sensor's clock may be off, and the poses that are reported may err; the truth does not."""
    preset = tiny.preset.model_copy(update={"pose_noise_m": 0.1, "pose_noise_deg": 1.0})
    mount = tiny.rig.sensors["thermal"].mount.model_copy(update={"clock_offset_ms": 12.0})
    sensor = tiny.rig.sensors["thermal"].model_copy(update={"mount": mount})
    rig = tiny.rig.model_copy(update={"sensors": {**tiny.rig.sensors, "thermal": sensor}})
    changed = Simulation.__new__(Simulation)
    changed.preset, changed.rig, changed.district = preset, rig, tiny.district
    turns = changed.exposures()
    thermal = next(turn for turn in turns if turn.sensor == "thermal" and turn.frame == 1)
    assert next(iter(changed.take(thermal))).message.stamp == thermal.time_ns + 12_000_000
    errors = []
    for turn in turns:
        if turn.sensor == "pose":
            true, reported = (sample.message.payload for sample in changed.take(turn))
            assert isinstance(true, Pose)
            assert isinstance(reported, Pose)
            errors.append((reported.map_from_base - true.map_from_base)[:3, 3])
    assert np.std(errors) == pytest.approx(0.1, rel=0.3)
