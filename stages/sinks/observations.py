"""Observations as files: what label propagation starts from."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.stage import Stage
from stages.observed import Observation, Said, write_observation
from stages.types import Cloud, Scan


class WriteObservations(Stage):
    """Writes each scan with what cameras said of it to `folder`/`<stamp in ns>.npz`.

    `cloud` holds the evidence of cameras alone, `fused` that with the LiDAR network, of the same
    scan; `scan` brings the remission. The clouds' points are the scan's, in its order.
    """

    def __init__(self, *, folder: Path) -> None:
        self._folder = Path(folder)

    def process(
        self,
        cloud: Message[Cloud],
        scan: Message[Scan],
        fused: Message[Cloud] | None = None,
    ) -> None:
        said, raw = cloud.payload, scan.payload
        for other in (raw.points, *([fused.payload.points] if fused else ())):
            if len(other) != len(said.points):
                raise StageError(
                    f"{len(other)} points beside a cloud of {len(said.points)}; give the scan that "
                    "the cloud was made of (sync: exact)"
                )
        observation = Observation(
            stamp=cloud.stamp,
            points=said.points,
            remission=raw.remission,
            shape=raw.shape,
            sensor=said.sensor,
            map_from_sensor=said.map_from_sensor,
            camera=Said.of(said),
            fused=Said.of(fused.payload) if fused else None,
            degraded=cloud.degraded or (fused is not None and fused.degraded),
        )
        write_observation(self._folder / f"{cloud.stamp:020d}.npz", observation)
