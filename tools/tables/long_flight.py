"""Fig 16: a long flight through a district, and how large its map grows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from stages.kernels.probability import read_out
from stages.kernels.render import add_legend, top_view
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from stages.voxel_map import VoxelMap
from tools.drawing.plot import Line, line_plot
from tools.tables.evidence import fused_evidence
from tools.tables.map_pictures import from_aside, legend_of, write_picture
from tools.tables.networks import ADAPTED, Networks
from tools.tables.scan_judging import ScanNetwork
from tools.tables.world import VOXEL_M, World

FLIGHT = "long"
#: The camera of the paper's side view stands low.
ELEVATION_DEG = 32.0
#: Wider pictures are reduced, pixels.
WIDEST = 2600
#: Rows of the table, besides the first scan.
QUARTERS = 4


@dataclass(frozen=True, slots=True)
class Growth:
    """The map after a scan."""

    scans: int
    flown_m: float
    voxels: int
    map_bytes: int
    process_bytes: int  #: resident, with the networks and the interpreter in it


def draw_long_flight(world: World, networks: Networks, folder: Path) -> list[Path]:
    """The map from aside and from above, of the fused evidence with the retrained network; and what
    it took, as a table and a plot. Raises OverflightError, Interrupted."""
    built, growth = mapped(world, networks.open("views-map", 0, 512, ADAPTED))
    voxels = built.snapshot()
    taxonomy = load_taxonomy()
    label, _, _ = read_out(voxels.log_scores, len(taxonomy))
    above = top_view(voxels.positions, label, taxonomy.colors, VOXEL_M, 2)
    side = from_aside(voxels.indices, label, elevation_deg=ELEVATION_DEG)
    written = [
        write_picture(folder / "figure-16-side.png", _reduced(side)),
        write_picture(
            folder / "figure-16-top.png", add_legend(above, legend_of(label), 2 / VOXEL_M)
        ),
    ]
    for name, text in (("md", table_of(growth)), ("svg", plot_of(growth))):
        with whole_file(folder / f"figure-16.{name}") as file:
            file.write(text.encode())
        written.append(folder / f"figure-16.{name}")
    return written


def mapped(world: World, network: ScanNetwork | None) -> tuple[VoxelMap, list[Growth]]:
    """The map of the long flight, and how it grew, scan by scan."""
    built = VoxelMap(voxel_m=VOXEL_M, classes=len(load_taxonomy()))
    growth: list[Growth] = []
    process, flown_m = psutil.Process(), 0.0
    before: NDArray[np.float64] | None = None
    for scan in world.judged(FLIGHT):
        observation = scan.observation
        pose = observation.map_from_sensor
        if pose is None:
            continue
        if before is not None:
            flown_m += float(np.linalg.norm(pose[:3, 3] - before))
        before = pose[:3, 3]
        cloud = fused_evidence(observation, network, cameras=True)
        built.integrate(cloud, pose, observation.stamp)
        resident = int(process.memory_info().rss)
        growth.append(Growth(len(growth) + 1, flown_m, built.used, built.nbytes, resident))
    return built, growth


def table_of(growth: list[Growth]) -> str:
    """The map at the first scan and at the quarters of the flight, as Markdown."""
    last = len(growth) - 1
    chosen = sorted({round(last * k / QUARTERS) for k in range(QUARTERS + 1)})
    lines = [
        "| flown, m | scans | voxels | map, MB | bytes per voxel | process, MB |",
        "|---|---|---|---|---|---|",
    ]
    for one in (growth[k] for k in chosen):
        lines.append(
            f"| {one.flown_m:.0f} | {one.scans} | {one.voxels:,} | {one.map_bytes / 1e6:.1f} | "
            f"{one.map_bytes / max(one.voxels, 1):.0f} | {one.process_bytes / 1e6:.0f} |"
        )
    first, end = growth[0], growth[-1]
    told = (
        f"The process holds {(end.process_bytes - first.process_bytes) / 1e6:.0f} MB more after "
        "the last scan than after the first; the map's arrays grow by a quarter at a time."
    )
    return "\n".join([*lines, "", told]) + "\n"


def plot_of(growth: list[Growth]) -> str:
    """Voxels and bytes over the way flown, as SVG."""
    voxels = [(one.flown_m, one.voxels / 1e5) for one in growth]
    held = [(one.flown_m, one.map_bytes / 1e7) for one in growth]
    lines = [Line("100,000 voxels", voxels), Line("10 MB of map", held, 1)]
    return line_plot(lines, "flown, m", "held by the map")


def _reduced(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    share = WIDEST / picture.shape[1]
    if share >= 1:
        return picture
    reduced = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, dtype=np.uint8)
