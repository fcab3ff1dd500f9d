"""The LiDAR segmentation stage with a network that says what the test wants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from accelerators.emulated import Emulated
from accelerators.registry import Registry
from pipeline.errors import DataError, ModelError
from pipeline.message import Message
from pipeline.model import ModelSpec, Tensor
from stages.kernels.probability import softmax
from stages.segment_scan import SegmentScan
from stages.types import Cloud, Scan

C = 15
ROAD, BUILDING, PERSON = 3, 1, 5


def organized(rows: int = 128, columns: int = 1024) -> np.ndarray:
    """A round room of radius 8 m."""
    elevation = np.pi / 4 - (np.arange(rows)[:, None] + 0.5) * np.pi / 2 / rows
    azimuth = np.pi - (np.arange(columns) + 0.5) * 2 * np.pi / columns
    flat = np.full((rows, columns), 8.0)
    x, y = flat * np.cos(azimuth), flat * np.sin(azimuth)
    return np.stack([x, y, flat * np.tan(elevation)], axis=-1).reshape(-1, 3).astype(np.float32)


def scan(points: np.ndarray, shape: tuple[int, int] | None, **changes: Any) -> Message[Scan]:
    fields = {"remission": np.full(len(points), 0.5, np.float32), "times_ns": None, **changes}
    return Message.at(7, Scan(points, shape=shape, sensor="lidar", **fields))


def stage(shape: tuple[int, int, int] = (64, 512, 5), **options: Any) -> SegmentScan:
    head = options.pop("head", {"kind": "scores"})
    result = SegmentScan(**options)
    result.model = ModelSpec("net", "range_image", shape, "float32", "", head)
    result.open()
    return result


def left_and_right(
    channels: int = 16, left: int = ROAD, right: int = BUILDING
) -> dict[str, Tensor]:
    """A network's answer: the left half of the image (y < 0 comes last) one class, else another."""
    scores = np.zeros((1, 64, 512, channels), np.float32)
    scores[:, :, :256, left], scores[:, :, 256:, right] = 6.0, 6.0
    return {"scores": Tensor(scores)}


@pytest.mark.parametrize("shape", [(128, 1024), None])
@pytest.mark.parametrize("back", ["cell", "neighbors"])
def test_points_take_what_the_network_says_of_their_side(
    shape: tuple[int, int] | None, back: str
) -> None:
    points = organized()
    points[1::97] = 0  # no return
    tested = stage(back=back)
    message = scan(points, shape, times_ns=np.arange(len(points), dtype=np.int32))
    image = tested.prepare(message)["range_image"].array
    assert image.shape == (1, 64, 512, 5)
    assert image.dtype == np.float32
    cloud = tested.finish(left_and_right(), message)
    assert isinstance(cloud, Cloud)
    assert cloud.points is points
    assert cloud.times_ns is message.payload.times_ns
    label = softmax(cloud.log_scores, C).argmax(axis=1)
    away = cloud.evidence & (abs(points[:, 1]) > 0.4) & (points[:, 0] > -7.9)
    assert away.sum() > 120_000
    np.testing.assert_array_equal(label[away], np.where(points[away, 1] > 0, ROAD, BUILDING))
    assert not cloud.evidence[1::97].any()
    assert (cloud.log_scores[:, C:] == -1e4).all()


def test_the_image_is_the_same_organized_and_projected() -> None:
    message = scan(organized(64, 512), (64, 512))
    network = {"sensor": "semantickitti_on_os0_128"}
    image = stage(**network).prepare(message)["range_image"].array
    projected = stage(organized=False, **network).prepare(message)["range_image"].array
    np.testing.assert_array_equal(image, projected)
    r = np.linalg.norm(message.payload.points.astype(np.float64), axis=1).reshape(64, 512)
    np.testing.assert_allclose(image[0, ..., 0], (r - 12.12) / 12.32, atol=1e-5)
    np.testing.assert_allclose(image[0, ..., 4], (0.5 - 0.06162) / 0.07131, atol=1e-5)


def test_a_network_without_remission_gets_four_channels() -> None:
    tensors = stage((64, 512, 4)).prepare(scan(organized(), (128, 1024), remission=None))
    assert tensors["range_image"].array.shape == (1, 64, 512, 4)


def test_points_beyond_the_range_limit_or_the_field_of_view_stay_unlabeled() -> None:
    points = np.array([[5, 0, 0], [100, 1, 0], [1, 0, 5], [0, 0, 0], [np.nan] * 3], np.float32)
    cloud = stage(max_range_m=50.0).finish(left_and_right(), scan(points, None))
    assert cloud.evidence.tolist() == [True, False, False, False, False]
    assert np.isfinite(cloud.log_scores).all()


def test_an_empty_scan_gives_an_empty_cloud() -> None:
    for back in ("cell", "neighbors"):
        tested = stage(back=back)
        message = scan(np.zeros((0, 3), np.float32), None)
        assert not tested.prepare(message)["range_image"].array.any()
        assert tested.finish(left_and_right(), message).log_scores.shape == (0, 16)


def test_probabilities_of_merged_classes_add_up() -> None:
    head = {"kind": "scores", "class_map": {1: "vehicle", 4: "vehicle", 9: "road"}}
    scores = np.zeros((1, 64, 512, 20), np.float32)
    scores[..., [1, 4]], scores[..., 9], scores[..., 0] = 2.0, 2.5, 1.0
    message = scan(organized(), (128, 1024))
    cloud = stage(head=head).finish({"scores": Tensor(scores)}, message)
    p = np.exp(cloud.log_scores[0, [13, ROAD]])
    assert p[0] / p[1] == pytest.approx(2 * np.exp(2.0 - 2.5), rel=1e-4)
    milder = stage(head=head, temperature=2.0).finish({"scores": Tensor(scores)}, message)
    q = np.exp(milder.log_scores[0, [13, ROAD]])
    assert q[0] / q[1] == pytest.approx(2 * np.exp((2.0 - 2.5) / 2), rel=1e-4)


def test_the_emulated_network_of_the_registry_fits() -> None:
    model = Registry.open().load("segment-scan", Emulated(latency_ms={"segment-scan": 0.0}))
    cloud = SegmentScan().run_once(scan(organized(), (128, 1024)), model=model)
    assert cloud.evidence.all()
    np.testing.assert_allclose(softmax(cloud.log_scores, C), 1 / C, rtol=1e-5)


def test_a_wrong_model_is_said() -> None:
    with pytest.raises(ModelError, match="'label_map'; SegmentScan takes 'scores'"):
        stage(head={"kind": "label_map"})
    with pytest.raises(ModelError, match="rows, columns, 4 or 5"):
        stage((64, 512, 3))
    with pytest.raises(ModelError, match="class_map: no class 'roda'; did you mean 'road'"):
        stage(head={"kind": "scores", "class_map": {0: "roda"}})
    with pytest.raises(ModelError, match="20 channels"):
        stage().finish(left_and_right(20), scan(organized(), (128, 1024)))


def test_wrong_options_are_said() -> None:
    with pytest.raises(ValueError, match="temperature must be above 0"):
        SegmentScan(temperature=0)
    with pytest.raises(ValueError, match="max_range_m must be above 0"):
        SegmentScan(max_range_m=-1)
    with pytest.raises(DataError, match="no sensor 'os9'"):
        stage(sensor="os9")


def test_a_real_kitti_scan_fills_its_range_image(shared: Path) -> None:
    file = shared / "data" / "semantickitti_00" / "velodyne" / "000000.bin"
    rows = np.fromfile(file, np.float32).reshape(-1, 4)
    tested = stage((64, 2048, 5), sensor="semantickitti")
    message = scan(rows[:, :3].copy(), None, remission=rows[:, 3].copy())
    image = tested.prepare(message)["range_image"].array[0]
    filled = image.any(axis=-1)
    assert filled.mean() > 0.6
    # The statistics are those of this kind of scan, so the channels come out about standard; but
    # for x, whose published mean (10.88 m) is that of the forward half only.
    assert abs(image[filled].mean(axis=0))[[0, 2, 3, 4]].max() < 0.6
    scores = np.zeros((1, 64, 2048, 16), np.float32)
    cloud = tested.finish({"scores": Tensor(scores)}, message)
    assert cloud.evidence.mean() > 0.97
