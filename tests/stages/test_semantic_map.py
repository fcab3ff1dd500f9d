"""The map stage: what it keeps, what it leaves out, what it publishes."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.message import Message
from stages import voxel_map
from stages.kernels.probability import softmax
from stages.semantic_map import SemanticMap
from stages.types import Cloud, SemanticVoxels


def cloud(number: int = 0, pose: bool = True, points: int = 2_000) -> Message[Cloud]:
    rng = np.random.default_rng(number)
    where = (rng.random((points, 3)) * 10).astype(np.float32)
    log_scores = rng.normal(size=(points, 16)).astype(np.float32)
    map_from_sensor = np.eye(4)
    map_from_sensor[0, 3] = number
    payload = Cloud(
        where, log_scores, rng.random(points) < 0.8, map_from_sensor if pose else None, "lidar"
    )
    return Message.at(number, payload)


def mapped(*clouds: Message[Cloud], publish_every: int = 1) -> list[SemanticVoxels | None]:
    stage = SemanticMap(publish_every=publish_every)
    stage.open()
    return [stage.process(message) for message in clouds]


def test_a_voxel_holds_the_product_of_its_points_and_their_mean() -> None:
    where = np.array([[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [-0.1, 0, 0]], np.float32)
    log_scores = np.zeros((3, 16), np.float32)
    log_scores[0, 3], log_scores[1, 3], log_scores[1, 5] = 1.0, 1.0, 0.5
    message = Message.at(0, Cloud(where, log_scores, np.ones(3, bool), np.eye(4), "lidar"))
    (voxels,) = mapped(message)
    assert voxels is not None
    assert voxels.indices.tolist() == [[0, 0, 0], [-1, 0, 0]]
    assert voxels.counts.tolist() == [2, 1]
    np.testing.assert_allclose(voxels.positions[0], (0.15, 0.1, 0.1), atol=1e-6)
    weights = np.ones(15)
    weights[3], weights[5] = np.exp(2.0), np.exp(0.5)
    np.testing.assert_allclose(
        softmax(voxels.log_scores, 15)[0], weights / weights.sum(), rtol=1e-5
    )


def test_a_snapshot_does_not_change_when_the_map_goes_on() -> None:
    stage = SemanticMap()
    stage.open()
    first = stage.process(cloud(0))
    assert first is not None
    before = [np.array(getattr(first, name)) for name in ("indices", "positions", "log_scores")]
    stage.process(cloud(0))
    stage.process(cloud(1))
    for name, array in zip(("indices", "positions", "log_scores"), before, strict=True):
        np.testing.assert_array_equal(getattr(first, name), array)


def test_two_runs_give_the_same_bytes() -> None:
    one, other = (mapped(*map(cloud, range(4)))[-1] for _ in range(2))
    assert one is not None
    assert other is not None
    for name in ("indices", "positions", "log_scores", "counts"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_a_map_that_outgrows_its_arrays_is_the_map_that_had_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    roomy = mapped(*map(cloud, range(4)))[-1]
    monkeypatch.setattr(voxel_map, "INITIAL_VOXELS", 16)
    grown = mapped(*map(cloud, range(4)))[-1]
    assert roomy is not None
    assert grown is not None
    assert len(grown.counts) > 4_000
    for name in ("indices", "positions", "log_scores", "counts"):
        np.testing.assert_array_equal(getattr(grown, name), getattr(roomy, name))


def test_a_cloud_without_a_pose_is_left_out_and_counted() -> None:
    stage = SemanticMap()
    stage.open()
    assert stage.process(cloud(pose=False)) is None
    assert stage.statistics()["clouds_without_pose"] == 1
    assert stage.statistics()["voxels"] == 0


def test_publish_every_n_publishes_each_nth_cloud() -> None:
    published = mapped(*map(cloud, range(7)), publish_every=3)
    assert [voxels is not None for voxels in published] == [False, False, True] * 2 + [False]


def test_an_empty_cloud_publishes_an_empty_map() -> None:
    (voxels,) = mapped(cloud(points=0))
    assert voxels is not None
    assert voxels.indices.shape == (0, 3)
    assert voxels.positions.dtype == np.float32


def test_wrong_options_are_said() -> None:
    with pytest.raises(ValueError, match="voxel_m must be above 0, not 0"):
        SemanticMap(voxel_m=0.0)
    with pytest.raises(ValueError, match="publish_every must be at least 1"):
        SemanticMap(publish_every=0)
