"""Presets, rigs and sensors as files; a mistake in one is told in a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import DataError
from stages.simulation.specification import LidarSpec, load_preset, load_rig, preset_names

PRESET = """\
rig: {rig}
seed: 1
duration_s: 1.0
speed_m_s: 2.0
height_m: [3.0, 5.0]
rates_hz: {{lidar: 10.0, pose: 100.0}}
"""


def written(folder: Path, name: str, text: str) -> str:
    (folder / name).write_text(text)
    return str(folder / name)


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_that_ships_has_a_rig_with_its_sensors(name: str) -> None:
    preset, folder = load_preset(name)
    rig = load_rig(preset, folder)
    assert set(preset.rates_hz) - {"pose"} <= set(rig.sensors)


def test_the_rig_that_maps_streets_looks_up_to_the_roofs_and_down_to_the_road() -> None:
    preset, folder = load_preset("train-car")
    highest = {}
    for name in ("car", "street"):
        rig = load_rig(preset.model_copy(update={"rig": name, "rates_hz": {"lidar": 5.0}}), folder)
        lidar = rig.sensors["lidar"]
        assert isinstance(lidar.spec, LidarSpec)
        level, azimuth = np.meshgrid(lidar.spec.elevations(), lidar.spec.azimuths(), indexing="ij")
        rays = np.stack(
            [np.cos(level) * np.cos(azimuth), np.cos(level) * np.sin(azimuth), np.sin(level)], -1
        )
        up = rays @ lidar.calibration.base_from_sensor[2, :3]
        highest[name] = float(np.degrees(np.arcsin(up.max())))
        assert np.degrees(np.arcsin(up.min())) < -20
    assert highest["car"] < 5 < 45 < highest["street"]


def test_the_rig_of_the_paper_has_two_cameras_that_overlap_and_see_the_ground_below() -> None:
    rig = load_rig(*load_preset("paper"))
    pitches = []
    for name in ("rgb", "rgb_lower"):
        calibration = rig.sensors[name].calibration
        assert calibration.camera is not None
        assert calibration.camera.size == (848, 480)
        pitches.append(-np.degrees(np.arcsin(calibration.base_from_sensor[2, 2])))
    half = np.degrees(np.arctan(240 / 424))
    assert pitches[0] - half < 0 < pitches[1] - half < pitches[0] + half
    assert pitches[1] + half > 85


def test_the_os0_looks_45_degrees_up_and_down_and_turns_clockwise() -> None:
    spec = load_rig(*load_preset("paper")).sensors["lidar"].spec
    assert isinstance(spec, LidarSpec)
    elevations, azimuths = spec.elevations(), spec.azimuths()
    assert np.degrees(elevations[[0, -1]]) == pytest.approx((45.0, -45.0))
    assert (len(elevations), len(azimuths)) == (128, 1024)
    assert (np.diff(azimuths) < 0).all()


def test_another_lidar_on_another_vehicle_is_a_file(tmp_path: Path) -> None:
    written(
        tmp_path,
        "cart.yaml",
        "body: none\nsensors:\n  lidar:\n    use: vlp.yaml\n    base_from_sensor: "
        "{translation: [0, 0, 1], rotation_rpy_deg: [0, 0, 0]}\n",
    )
    written(
        tmp_path,
        "vlp.yaml",
        "kind: lidar\ncolumns: 900\nelevation_deg: {first: 15.0, last: -15.0, count: 16}\n"
        "min_m: 0.5\nmax_m: 100.0\nfull_m: 40.0\nnoise_m: 0.03\n",
    )
    name = written(tmp_path, "mine.yaml", PRESET.format(rig="cart.yaml"))
    rig = load_rig(*load_preset(name))
    spec = rig.sensors["lidar"].spec
    assert isinstance(spec, LidarSpec)
    assert len(spec.elevations()) == 16


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (PRESET.format(rig="m211"), r"no rig 'm211'; take one of car, m210, street"),
        (PRESET.format(rig="m210").replace("lidar:", "radar:"), "has no sensor 'radar'"),
        (PRESET.format(rig="m210").replace("seed: 1", "sed: 1"), "seed: Field required"),
        (PRESET.format(rig="m210").replace("2.0", "-2.0"), "speed_m_s: .* greater than 0"),
        ("- 1\n", "give keys and values"),
        ("a: [\n", "not YAML"),
    ],
)
def test_a_mistake_in_a_preset_names_the_key(tmp_path: Path, text: str, told: str) -> None:
    name = written(tmp_path, "mine.yaml", text)
    with pytest.raises(DataError, match=told):
        load_rig(*load_preset(name))


def test_an_unknown_preset_is_answered_with_those_there_are() -> None:
    with pytest.raises(DataError, match="no preset 'demmo'; take one of demo, judge, paper"):
        load_preset("demmo")


def test_a_scaled_camera_sees_the_same_field() -> None:
    rig = load_rig(*load_preset("tiny"))
    camera = rig.sensors["rgb"].calibration.camera
    assert camera is not None
    assert camera.size == (212, 120)
    assert camera.fx == pytest.approx(106.0)
    assert (camera.cx + 0.5) / 212 == pytest.approx(0.5)
