"""Mixtures of sources, how scans are varied, and what a network gets of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from scan_folders import sequence

from pipeline.errors import DataError
from stages.scan_statistics import SHIPPED
from tools.train.point_segmenter import PointSegmenter
from tools.train.salsanext import SalsaNext
from tools.train.scan_mix import Mix, open_mix
from tools.train.scan_recipes import RECIPES, azimuth_of_column, recipe_named, varied

ROAD, VEHICLE = 3, 13
SENSOR = "semantickitti"


def mixture(folder: Path, text: str) -> Mix:
    sequence(folder / "a", scans=2)
    sequence(folder / "b", scans=5, seed=1)
    (folder / "mix.yaml").write_text(text)
    return open_mix(folder / "mix.yaml", SHIPPED, SENSOR)


def segmenter(mix: Mix, recipe: str = "plain", **more: int) -> PointSegmenter:
    network = SalsaNext(16, channels=more.get("channels", 5), width=0.25)
    return PointSegmenter(network, mix, RECIPES[recipe], **more)


def test_sources_are_drawn_by_their_shares(tmp_path: Path) -> None:
    mix = mixture(tmp_path, "sources: [{path: a, share: 1}, {path: b, share: 3}]")
    random = np.random.default_rng(0)
    drawn = [mix.draw(random)[0] is mix.parts[1] for _ in range(400)]
    assert 0.68 < np.mean(drawn) < 0.82
    assert "25 % a: 2 scans; 75 % b: 5 scans" in mix.told
    assert len(mix.sample(8)) == 2 + 5
    counts = np.array(mix.counts())
    assert counts[[ROAD, VEHICLE]].sum() == pytest.approx(1e6, abs=5)
    assert counts[0] == 0


def test_a_path_alone_is_a_mixture_of_one(tmp_path: Path) -> None:
    mix = open_mix(sequence(tmp_path / "a"), SHIPPED, SENSOR)
    assert [part.share for part in mix.parts] == [1.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sources: []", "share above 0"),
        ("sources: [{path: a, share: 0}]", "share above 0"),
        ("sources: [{path: a}]", r"no mixture \(KeyError\('share'\)\)"),
        ("sources: [{path: a, share: 1, weight: 2}]", r"sources\[0\]: no key 'weight'"),
        ("sources: [{share: 1}]", "needs a path"),
        ("sources: [{path: c, share: 1}]", "c: no such file"),
        ("sources: [{path: a, share: 1, sensor: os9}]", "no sensor 'os9'"),
        ("sources: [{path: a, share: 1, labels: false}]", "no source has labels"),
    ],
)
def test_a_mistake_in_a_mixture_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        mixture(tmp_path, text)


def test_scans_without_labels_are_seen_and_teach_nothing(tmp_path: Path) -> None:
    mix = mixture(tmp_path, "sources: [{path: a, share: 1}, {path: b, share: 1, labels: false}]")
    task = segmenter(mix, batch_size=16)
    batch = task.batch(np.random.default_rng(0))
    taught = [bool(one.any()) for one in batch["classes"]]
    assert 0 < sum(taught) < 16
    assert all(bool((one[0] != 0).any()) for one in batch["input"])


def test_a_source_may_be_normalized_with_its_own_sensors_figures(tmp_path: Path) -> None:
    mix = mixture(
        tmp_path,
        "sources: [{path: a, share: 1}, {path: b, share: 1, sensor: os0_128_simulated}]",
    )
    own, other = (part.statistics for part in mix.parts)
    assert own.elevation_rad == other.elevation_rad
    assert own.mean[3] != other.mean[3]


def test_remission_is_left_out_where_a_source_is_of_another_sensor(tmp_path: Path) -> None:
    assert open_mix(sequence(tmp_path / "one"), SHIPPED, SENSOR).channels == 5
    same = f"sources: [{{path: a, share: 1}}, {{path: b, share: 1, sensor: {SENSOR}}}]"
    assert mixture(tmp_path / "same", same).channels == 5
    other = "sources: [{path: a, share: 1}, {path: b, share: 1, sensor: os0_128_simulated}]"
    assert mixture(tmp_path / "other", other).channels == 4


def test_a_batch_has_the_networks_channels_and_the_classes_under_them(tmp_path: Path) -> None:
    mix = open_mix(sequence(tmp_path / "a"), SHIPPED, SENSOR)
    for channels in (4, 5):
        batch = segmenter(mix, channels=channels, columns=128).batch(np.random.default_rng(3))
        assert batch["input"].shape == (4, channels, 64, 128)
        seen, classes = batch["input"][:, 0] != 0, batch["classes"]
        assert set(np.unique(classes)) <= {0, ROAD, VEHICLE}
        assert not classes[~seen].any()


def test_the_same_generator_gives_the_same_batch(tmp_path: Path) -> None:
    task = segmenter(open_mix(sequence(tmp_path / "a"), SHIPPED, SENSOR), "strong")
    first, again = (task.batch(np.random.default_rng(5))["input"].numpy() for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_rare_classes_come_into_the_columns_that_are_learned_from(tmp_path: Path) -> None:
    """The car fills 1/16 of the turn: a quarter of the turn at random holds some of it in a third
    of the draws; half of the draws turn a class of the scan there, the car in half of those."""
    mix = open_mix(sequence(tmp_path / "a"), SHIPPED, SENSOR)
    task = segmenter(mix, columns=128, batch_size=200)
    classes = task.batch(np.random.default_rng(0))["classes"]
    assert np.mean([bool((one == VEHICLE).any()) for one in classes]) > 0.42


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("name", sorted(RECIPES))
def test_a_point_is_turned_to_the_column_that_was_asked_for(name: str, mirrored: bool) -> None:
    point = np.array([[8.0, 3.0, -1.0], [0, 0, 0]], np.float32)
    recipe = RECIPES[name]
    wanted = azimuth_of_column(100.0, 512)
    azimuth = np.arctan2(-3.0 if mirrored else 3.0, 8.0)
    moved, _, _ = varied(
        point, np.ones(2, np.float32), recipe, wanted - azimuth, mirrored, np.random.default_rng(0)
    )
    off = (np.arctan2(moved[0, 1], moved[0, 0]) - wanted + np.pi) % (2 * np.pi) - np.pi
    assert abs(off) < 0.001 + np.arctan(1.5 * recipe.shift_m / 8) + recipe.tilt_rad
    assert not moved[1].any()  # no return stays none


def test_plain_turns_and_mirrors_alone_and_strong_moves() -> None:
    points = np.random.default_rng(0).uniform(-20, 20, (500, 3)).astype(np.float32)
    remission = np.full(500, 0.5, np.float32)
    random = np.random.default_rng(1)
    moved, same, _ = varied(points, remission, RECIPES["plain"], 1.0, True, random)
    before, after = (np.linalg.norm(p, axis=1) for p in (points, moved))
    np.testing.assert_allclose(before, after, rtol=1e-5)
    np.testing.assert_array_equal(same, remission)
    moved, other, here = varied(points, remission, RECIPES["strong"], 1.0, True, random)
    assert abs(np.linalg.norm(moved, axis=1) - before).max() > 0.2
    assert (other != remission).any()
    assert here.mean() > 0.5


def test_an_unknown_recipe_is_named() -> None:
    with pytest.raises(DataError, match=r"no recipe 'hard' \(known: plain, strong"):
        recipe_named("hard")
