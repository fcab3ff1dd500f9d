from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import typer

from pipeline.drivers.plan import Bar
from pipeline.scheduling.events import Step
from pipeline.scheduling.topology import StageNode, Topology
from tools.drawing.gantt import WIDTH, gantt
from tools.drawing.picture import SCALE, Picture, Rectangle, Words, write_picture

MS = 1_000_000
TOPOLOGY = Topology((StageNode("camera"), StageNode("net"), StageNode("fuse")))
BARS = (
    Bar("net", Step.PREPARE, None, 0, 10 * MS),
    Bar("net", Step.INFER, "tpu", 10 * MS, 60 * MS),
    Bar("fuse", Step.PROCESS, None, 90 * MS, 140 * MS),
    Bar("fuse", Step.PROCESS, None, 200 * MS, 220 * MS),
)


def drawn() -> Picture:
    return gantt(BARS, TOPOLOGY, (0.0, 0.1), "a schedule")


def rectangles(picture: Picture) -> list[Rectangle]:
    return [shape for shape in picture.shapes if isinstance(shape, Rectangle) and shape.title]


def test_bars_stand_in_time_and_are_cut_at_the_edge() -> None:
    prepare, infer, fuse = rectangles(drawn())
    assert infer.x - prepare.x == pytest.approx(WIDTH / 10)
    assert infer.width == pytest.approx(WIDTH / 2, abs=1)
    assert fuse.x + fuse.width == pytest.approx(prepare.x + WIDTH, abs=1)
    assert infer.title == "net infer, 50.0 ms"


def test_a_device_has_a_line_of_its_own_and_a_stage_keeps_its_color() -> None:
    picture = drawn()
    prepare, infer, fuse = rectangles(picture)
    assert prepare.color == infer.color != fuse.color
    assert infer.y < prepare.y < fuse.y
    words = [shape.text for shape in picture.shapes if isinstance(shape, Words)]
    assert {"tpu", "net", "fuse", "a schedule", "ms"} <= set(words)
    assert "camera" not in words  # it has no bar


def test_svg_and_png_show_the_same(tmp_path: Path) -> None:
    picture = drawn()
    write_picture(picture, tmp_path / "a" / "schedule.svg")
    write_picture(picture, tmp_path / "schedule.png")
    root = ElementTree.parse(tmp_path / "a" / "schedule.svg").getroot()
    assert root.attrib["width"] == f"{picture.width:.0f}"
    pixels = cv2.imread(str(tmp_path / "schedule.png"))
    assert pixels is not None
    assert pixels.shape[:2] == (round(picture.height * SCALE), round(picture.width * SCALE))
    for bar in rectangles(picture):
        at = pixels[round((bar.y + 2) * SCALE), round((bar.x + 2) * SCALE)]
        blue, green, red = (int(part) for part in at)
        assert f"#{red:02x}{green:02x}{blue:02x}" == bar.color
    assert np.all(pixels[2, 2] == 255)


def test_a_schedule_without_a_step_is_an_empty_picture() -> None:
    assert rectangles(gantt((), TOPOLOGY, (0.0, 1.0), "nothing")) == []


def test_a_place_where_nothing_can_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(typer.BadParameter, match="cannot write"):
        write_picture(drawn(), tmp_path / "file" / "schedule.svg")
