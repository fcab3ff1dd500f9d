"""The paper's figures of label propagation, as pictures of a simulated world: `--figure`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from stages.kernels.map_query import select
from stages.kernels.probability import read_out
from stages.kernels.render import add_legend, top_view
from stages.kernels.voxels import pack
from stages.observed import Observation, Said
from stages.taxonomy import load_taxonomy
from tools.propagation.pictures import range_panels
from tools.tables.daylight import draw_daylight
from tools.tables.disaster import draw_disaster
from tools.tables.experiment import Experiment
from tools.tables.long_flight import draw_long_flight
from tools.tables.map_pictures import from_aside, legend_of, map_of, write_picture
from tools.tables.networks import ADAPTED, Networks
from tools.tables.simulated import tables_of
from tools.tables.table import Table
from tools.tables.unseen_persons import draw_unseen_persons, recall_tables
from tools.tables.views import cloud_of_flight
from tools.tables.world import World
from tools.train.aggregated import AggregatedCloud, scan_from
from tools.train.scan_sources import LabeledPoints

CONFIDENCE = 0.5
WINDOWS = (0, 2, 5)
#: Above the vehicle, m, in the pictures of views.
HEIGHT_M = 8.0


def draw_views(cloud: AggregatedCloud, folder: Path) -> list[Path]:
    """Fig 5: the cloud from above, and a scan that an OS0 would take over it. Fig 6: that scan with
    what moves from 0, 2 and 5 scans to each side."""
    taxonomy = load_taxonomy()
    middle = len(cloud.path) // 2
    place = cloud.path[middle] + [0, 0, HEIGHT_M]
    scans = {window: scan_from(cloud, place, middle, window=window) for window in WINDOWS}
    above = top_view(cloud.points, cloud.classes, taxonomy.colors, 0.25, 2)
    legend = legend_of(cloud.classes)
    shown = _observation(scans[2])
    labelings: dict[str, NDArray[np.uint8] | None] = {
        f"what moves from {window} scans to each side": scans[window].classes for window in WINDOWS
    }
    return [
        write_picture(folder / "figure-5-cloud.png", add_legend(above, legend, 8.0)),
        write_picture(
            folder / "figure-5-scan.png",
            range_panels(shown, {f"from {HEIGHT_M:g} m above": scans[2].classes}),
        ),
        write_picture(folder / "figure-6.png", range_panels(_observation(scans[5]), labelings)),
    ]


def draw_maps(world: World, networks: Networks, flight: str, folder: Path) -> list[Path]:
    """Fig 13 (flight A) and 15 (flight B): the true map, fused, camera-only, and fused with the
    retrained network; Fig 14: the same without what moves. Raises OverflightError, Interrupted."""
    number = {"flight_a": 13, "flight_b": 15}[flight]
    before = networks.open("source", 0, 512, ADAPTED)
    after = networks.open("views-map", 0, 512, ADAPTED)
    maps = {
        "b-fused": map_of(world, flight, before, cameras=True),
        "c-camera-only": map_of(world, flight, None, cameras=True),
        "d-fused-retrained": map_of(world, flight, after, cameras=True),
    }
    true, frame = world.true_map(flight), maps["b-fused"].indices  # every voxel that was hit
    hit = np.isin(pack(true.indices), pack(frame))
    written = [
        write_picture(
            folder / f"figure-{number}-a-true.png",
            from_aside(true.indices[hit], true.classes[hit], frame),
        )
    ]
    classes = len(load_taxonomy())
    dynamic = np.flatnonzero(load_taxonomy().dynamic).tolist()
    for name, voxels in maps.items():
        for figure, without in ((number, []), (14, dynamic)):
            rows = select(
                voxels.positions,
                voxels.log_scores,
                classes,
                without=without,
                min_confidence=CONFIDENCE,
            )
            label, _, _ = read_out(voxels.log_scores[rows], classes)
            target = (
                folder / f"figure-{figure}-{name}{'' if figure == number else '-' + flight}.png"
            )
            written.append(write_picture(target, from_aside(voxels.indices[rows], label, frame)))
    return written


def draw_figure(
    number: int, experiment: Experiment, console: Console
) -> tuple[list[Path], Sequence[Table]]:
    """The pictures of a figure, below the world's folder, and what is counted beside them."""
    one = experiment
    folder = one.world.folder / "figures"
    if number in (5, 6):
        return draw_views(cloud_of_flight(one.world.flights("views")[0]), folder), ()
    if number == 12:
        return draw_unseen_persons(one, folder), recall_tables(one)
    if number == 16:
        return draw_long_flight(one.world, one.networks, folder), ()
    if number == 17:
        return draw_disaster(one.world, one.networks, folder), tables_of(one, "17")
    if number == 18:
        return draw_daylight(one, folder), ()
    flight = "flight_b" if number == 15 else "flight_a"
    console.print(f"mapping {flight} three times ...", highlight=False)
    return draw_maps(one.world, one.networks, flight, folder), ()


def _observation(scan: LabeledPoints) -> Observation:
    nothing = Said(np.zeros(0, np.int32), np.zeros((0, 16), np.float16))
    return Observation(
        0, scan.points, scan.remission, scan.shape, "lidar", None, nothing, None, False
    )
