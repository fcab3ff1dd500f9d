from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import graphs
from tools.drawing.diagram import Arrow, Box, Diagram, Socket
from tools.drawing.svg import svg
from tools.load import open_graph

SVG = "{http://www.w3.org/2000/svg}"


def drawn(diagram: Diagram) -> ElementTree.Element:
    return ElementTree.fromstring(svg(diagram))


def pair(name: str = "fuse<&>", devices: tuple[str, ...] = ("igpu", "cpu")) -> Diagram:
    socket = Socket("image", "nearest", "nearest ±70 ms")
    return Diagram(
        "pair",
        (
            Box("camera", "m:Camera", (), None, (), ("out",)),
            Box(name, "m:Fuse", devices, "net", (socket,), ("labels", "debug")),
        ),
        (Arrow("camera", "out", name, "image", "nearest", "nearest ±70 ms"),),
    )


def test_names_devices_and_rules_are_written_out() -> None:
    texts = {"".join(text.itertext()) for text in drawn(pair()).iter(f"{SVG}text")}
    assert {"camera", "fuse<&>", "igpu → cpu", "imagenearest ±70 ms", "labels", "debug"} <= texts


def test_a_synchronized_edge_is_dashed() -> None:
    edge = next(path for path in drawn(pair()).iter(f"{SVG}path") if path.get("stroke-width"))
    assert edge.get("stroke-dasharray")


def test_stages_on_other_devices_have_other_colors() -> None:
    first = svg(pair(devices=("igpu", "cpu")))
    fills = {box.get("fill") for box in drawn(pair()).iter(f"{SVG}rect")}
    assert len(fills) >= 5  # paper, card, sensor, igpu, cpu
    assert first != svg(pair(devices=("cpu", "igpu")))


def test_everything_lies_inside_the_picture() -> None:
    picture = drawn(pair())
    _, _, width, height = map(float, picture.get("viewBox", "").split())
    for box in list(picture.iter(f"{SVG}rect"))[1:]:
        assert float(box.get("x", "nan")) >= 0
        assert float(box.get("x", "nan")) + float(box.get("width", "nan")) <= width
        assert float(box.get("y", "nan")) >= 0
        assert float(box.get("y", "nan")) + float(box.get("height", "nan")) <= height


def test_the_legend_stands_below_an_edge_that_passes_under_all_boxes() -> None:
    graph, _ = open_graph(Path(graphs.__file__).parent / "emulated_uav.yaml")
    picture = drawn(Diagram.of(graph))
    legend = min(
        float(rect.get("y", "nan"))
        for rect in picture.iter(f"{SVG}rect")
        if rect.get("width") == rect.get("height") == "10"
    )
    numbers = re.compile(r"-?[0-9.]+ (-?[0-9.]+)")
    edges = [path for path in picture.iter(f"{SVG}path") if path.get("fill") == "none"]
    lowest = max(float(y) for path in edges[:-2] for y in numbers.findall(path.get("d", "")))
    assert lowest < legend


def test_an_empty_graph_is_an_empty_picture() -> None:
    assert drawn(Diagram("nothing", (), ())).get("viewBox")
