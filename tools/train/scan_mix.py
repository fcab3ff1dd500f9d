"""Several sources of scans in one training, and how often each is drawn: a YAML file.

    sources:
      - {path: city101.mcap, share: 0.35}
      - {path: labels, share: 0.65, sensor: os0_128_simulated}

Paths are relative to the file. `share` is relative to the sum of all, `layout` names the reader
where the path does not say, `sensor` an entry of the scan statistics that this source is normalized
with. With `labels: false` its scans are seen without labels: they move the normalizations alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pipeline.errors import DataError
from stages.scan_statistics import ScanStatistics
from stages.types import CHANNELS
from tools.train.open_scans import open_scans
from tools.train.scan_sources import LabeledPoints, ScanSource

KEYS = ("path", "share", "layout", "sensor", "labels")
#: So many scans of a source tell how frequent its classes are.
COUNTED = 64


@dataclass(frozen=True, slots=True)
class Part:
    """One source of a mixture."""

    source: ScanSource
    share: float  #: of all draws
    statistics: ScanStatistics  #: what its scans are normalized with
    labeled: bool  #: False: its labels are left out, its scans only move the normalizations


@dataclass(frozen=True, slots=True)
class Mix:
    """What a training draws from."""

    parts: tuple[Part, ...]
    one_sensor: bool = True  #: no source is said to be of another sensor than the network's

    @property
    def channels(self) -> int:
        """Of the input: with remission where all sources share the sensor, as another LiDAR's
        remission misleads; 5 or 4."""
        return 5 if self.one_sensor else 4

    @property
    def told(self) -> str:
        """In words, for the model card."""
        return "; ".join(f"{100 * one.share:.0f} % {one.source.told}" for one in self.parts)

    def draw(self, random: np.random.Generator) -> tuple[Part, LabeledPoints]:
        """A scan, its part first."""
        number = int(random.choice(len(self.parts), p=[one.share for one in self.parts]))
        part = self.parts[number]
        return part, part.source.read(int(random.integers(len(part.source))))

    def counts(self) -> list[int]:
        """(CHANNELS,) points of each class, as often as they are drawn; in millionths."""
        total = np.zeros(CHANNELS)
        for part in self.parts:
            if not part.labeled:
                continue
            mine = np.zeros(CHANNELS)
            for number in _spread(len(part.source), COUNTED):
                classes = part.source.read(number).classes
                mine += np.bincount(classes, minlength=CHANNELS)[:CHANNELS]
            mine[0] = 0
            total += part.share * mine / max(mine.sum(), 1)
        return [round(1e6 * float(share)) for share in total]

    def sample(self, count: int) -> list[tuple[Part, LabeledPoints]]:
        """So many scans over all labeled parts, always the same."""
        labeled = [part for part in self.parts if part.labeled]
        whole = sum(part.share for part in labeled)
        chosen = []
        for part in labeled:
            mine = max(1, round(count * part.share / whole))
            chosen += [(part, part.source.read(k)) for k in _spread(len(part.source), mine)]
        return chosen


def open_mix(path: Path, statistics: Path, sensor: str) -> Mix:
    """The mixture in a YAML file, or the one source at a path. Raises DataError."""
    own = ScanStatistics.read(statistics, sensor)
    if path.suffix not in (".yaml", ".yml"):
        return Mix((Part(open_scans(path), 1.0, own, True),))
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        entries = content["sources"]
        shares = [float(entry["share"]) for entry in entries]
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: no mixture ({error!r}); it holds sources: [{{path, share}}, ...]"
        ) from None
    if not entries or min(shares) <= 0:
        raise DataError(f"{path}: every source needs a share above 0")
    parts = [
        _part(path, number, entry, share / sum(shares), own, statistics)
        for number, (entry, share) in enumerate(zip(entries, shares, strict=True))
    ]
    if not any(part.labeled for part in parts):
        raise DataError(f"{path}: no source has labels; leave out 'labels: false' of one")
    return Mix(tuple(parts), all(entry.get("sensor") in (None, sensor) for entry in entries))


def _part(
    path: Path,
    number: int,
    entry: dict[str, Any],
    share: float,
    own: ScanStatistics,
    statistics: Path,
) -> Part:
    where = f"{path}: sources[{number}]"
    unknown = [key for key in entry if key not in KEYS]
    if unknown:
        raise DataError(f"{where}: no key '{unknown[0]}' (known: {', '.join(KEYS)})")
    if "path" not in entry:
        raise DataError(f"{where}: needs a path")
    source = open_scans(path.parent / str(entry["path"]), entry.get("layout"))
    normal = own
    if entry.get("sensor") is not None:
        other = ScanStatistics.read(statistics, str(entry["sensor"]))
        # The image is the network's; only what its channels are normalized with is the source's.
        normal = ScanStatistics(own.elevation_rad, other.mean, other.std)
    return Part(source, share, normal, bool(entry.get("labels", True)))


def _spread(length: int, count: int) -> list[int]:
    chosen = np.linspace(0, length - 1, min(count, length)).round().astype(int)
    return [int(number) for number in chosen]
