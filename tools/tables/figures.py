"""The paper's figures of label propagation, as pictures of a simulated world: `--figure`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from stages.kernels.map_query import select
from stages.kernels.probability import read_out
from stages.kernels.render import add_legend, encode_png, oblique_view, top_view
from stages.kernels.voxels import pack
from stages.observed import Observation, Said
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, SemanticVoxels
from stages.voxel_map import VoxelMap
from tools.propagation.pictures import range_panels
from tools.tables.evidence import fused_evidence
from tools.tables.networks import ADAPTED, Networks
from tools.tables.scan_judging import ScanNetwork
from tools.tables.views import cloud_of_flight
from tools.tables.world import World
from tools.train.aggregated import AggregatedCloud, scan_from
from tools.train.scan_sources import LabeledPoints

VOXEL_M, CONFIDENCE = 0.25, 0.5
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
    legend = [(n, taxonomy.colors[k].tolist()) for k, n in enumerate(taxonomy.names) if k]
    shown = _observation(scans[2])
    labelings: dict[str, NDArray[np.uint8] | None] = {
        f"what moves from {window} scans to each side": scans[window].classes for window in WINDOWS
    }
    return [
        _write(folder / "figure-5-cloud.png", add_legend(above, legend, 8.0)),
        _write(
            folder / "figure-5-scan.png",
            range_panels(shown, {f"from {HEIGHT_M:g} m above": scans[2].classes}),
        ),
        _write(folder / "figure-6.png", range_panels(_observation(scans[5]), labelings)),
    ]


def draw_maps(world: World, networks: Networks, flight: str, folder: Path) -> list[Path]:
    """Fig 13 (flight A) and 15 (flight B): the true map, fused, camera-only, and fused with the
    retrained network; Fig 14: the same without what moves. Raises OverflightError, Interrupted."""
    number = {"flight_a": 13, "flight_b": 15}[flight]
    before = networks.open("source", 0, 512, ADAPTED)
    after = networks.open("views-map", 0, 512, ADAPTED)
    maps = {
        "b-fused": _map(world, flight, before, cameras=True),
        "c-camera-only": _map(world, flight, None, cameras=True),
        "d-fused-retrained": _map(world, flight, after, cameras=True),
    }
    true = world.true_map(flight)
    hit = np.isin(pack(true.indices), pack(maps["b-fused"].indices))
    written = [
        _write(
            folder / f"figure-{number}-a-true.png",
            _picture(true.indices[hit], true.classes[hit]),
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
            written.append(_write(target, _picture(voxels.indices[rows], label)))
    return written


def draw_figure(number: int, world: World, networks: Networks, console: Console) -> list[Path]:
    """The pictures of a figure, below the world's folder."""
    folder = world.folder / "figures"
    if number in (5, 6):
        return draw_views(cloud_of_flight(world.flights("views")[0]), folder)
    flight = "flight_b" if number == 15 else "flight_a"
    console.print(f"mapping {flight} three times ...", highlight=False)
    return draw_maps(world, networks, flight, folder)


def _map(
    world: World, flight: str, network: ScanNetwork | None, *, cameras: bool
) -> SemanticVoxels:
    built = VoxelMap(voxel_m=VOXEL_M, classes=len(load_taxonomy()))
    for scan in world.judged(flight):
        observation = scan.observation
        if observation.map_from_sensor is None:
            continue
        cloud: Cloud = fused_evidence(observation, network, cameras=cameras)
        built.integrate(cloud, observation.map_from_sensor, observation.stamp)
    return built.snapshot()


def _picture(indices: NDArray[np.int32], labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    taxonomy = load_taxonomy()
    present: Mapping[int, None] = dict.fromkeys(np.unique(labels).tolist())
    legend = [(taxonomy.names[k], taxonomy.colors[k].tolist()) for k in present if k]
    return add_legend(oblique_view(indices, labels, taxonomy.colors), legend)


def _observation(scan: LabeledPoints) -> Observation:
    nothing = Said(np.zeros(0, np.int32), np.zeros((0, 16), np.float16))
    return Observation(
        0, scan.points, scan.remission, scan.shape, "lidar", None, nothing, None, False
    )


def _write(path: Path, picture: NDArray[np.uint8]) -> Path:
    with whole_file(path) as file:
        file.write(encode_png(picture))
    return path
