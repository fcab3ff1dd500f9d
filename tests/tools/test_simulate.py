"""`overflight simulate`: a whole file or none, made once, the same on any number of threads."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.recording.mcap import McapReader
from stages.sources.recording import Recording, calibration
from tools import simulate
from tools.simulate import in_order


@pytest.mark.slow
def test_a_flight_is_made_once_and_holds_every_sensor_with_its_truth(
    overflight: Callable[..., Any], tmp_path: Path
) -> None:
    answer = overflight("simulate", "tiny", "-o", "out/tiny.mcap", "--json")
    assert answer.code == 0, answer.err
    made = json.loads(answer.out)
    assert made["cached"] is False
    sensors = {"rgb", "rgb/depth", "rgb_lower", "rgb_lower/depth", "thermal", "lidar", "pose"}
    truth = {f"truth/{name}" for name in ("rgb", "rgb/boxes", "lidar", "pose", "map", "thermal")}
    assert sensors | truth <= made["messages"].keys()
    assert json.loads(overflight("simulate", "tiny", "-o", "out/tiny.mcap", "--json").out)["cached"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["tiny.mcap"]
    path = tmp_path / "out/tiny.mcap"
    assert set(calibration(path=path).cameras()) == {"rgb", "rgb_lower", "thermal"}
    for topic in sensors | truth:
        source = Recording(path=path, topic=topic)
        source.open()
        assert len(list(source.messages())) == made["messages"][topic]
    # Another preset is another flight: the file is made anew; this one wants no map.
    preset = tmp_path / "short.yaml"
    preset.write_text(
        "{rig: m210, seed: 8, duration_s: 0.2, speed_m_s: 2.6, height_m: [4.5, 5.5], scale: 0.25,"
        " rates_hz: {rgb: 5.0, pose: 50.0}, true_map: false}"
    )
    other = json.loads(overflight("simulate", preset, "-o", "out/tiny.mcap", "--json").out)
    assert other["cached"] is False
    assert "truth/rgb" in other["messages"]
    assert "truth/map" not in other["messages"]


@pytest.mark.slow
def test_a_flight_that_is_interrupted_leaves_no_file(
    overflight: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = []

    def interrupted(*_: object) -> None:
        taken.append(1)
        if len(taken) == 20:
            raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "_append", interrupted)
    assert overflight("simulate", "tiny", "-o", "tiny.mcap").code != 0
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_another_kind_is_not_replaced(
    overflight: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "mine.mcap").write_text("my only recording")
    answer = overflight("simulate", "tiny", "-o", "mine.mcap")
    assert answer.code == 2
    assert "mine.mcap exists and is no simulated flight" in answer.err
    assert (tmp_path / "mine.mcap").read_text() == "my only recording"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("demmo",), "no preset 'demmo'; take one of demo"),
        (("none.yaml",), "cannot read none.yaml"),
    ],
)
def test_a_wrong_preset_is_a_sentence(
    overflight: Callable[..., Any], words: tuple[str, ...], told: str
) -> None:
    answer = overflight("simulate", *words)
    assert answer.code == 2
    assert told in answer.err
    assert "Traceback" not in answer.err


def test_results_come_in_the_order_of_the_items_and_no_further_than_asked() -> None:
    begun: list[int] = []

    def work(item: int) -> int:
        begun.append(item)
        return -item

    results = in_order(work, range(1000), workers=2)
    assert [next(results) for _ in range(3)] == [0, -1, -2]
    results.close()  # type: ignore[attr-defined]
    assert len(begun) < 20


def test_a_whole_file_is_named_by_what_it_was_made_from(tmp_path: Path) -> None:
    from pipeline.recording.mcap import McapWriter

    path = tmp_path / "f.mcap"
    with McapWriter(path) as file:
        file.note(simulate.NOTE, {"preset": "x"})
    assert simulate.holds(path, {"preset": "x"})
    assert not simulate.holds(path, {"preset": "y"})
    assert not simulate.holds(tmp_path / "none.mcap", {"preset": "x"})
    assert McapReader(path).is_whole()
