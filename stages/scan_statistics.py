"""What the channels of a range image are normalized with, read from and written to a YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.kernels.channel_moments import adapted

#: The statistics that come with Overflight.
SHIPPED = Path(__file__).with_name("scan_statistics.yaml")


@dataclass(frozen=True, slots=True, eq=False)
class ScanStatistics:
    """The field of view of a range image and what its channels are normalized with."""

    elevation_rad: tuple[float, float]  #: of the lowest and the highest row's outer edge
    mean: NDArray[np.float32]  #: (5,) range, x, y, z in m, remission 0..1
    std: NDArray[np.float32]  #: (5,)

    @classmethod
    def read(cls, file: Path, sensor: str) -> ScanStatistics:
        """The entry `sensor` of a statistics file. Raises DataError with what is wrong."""
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
            if sensor not in content:
                raise DataError(f"{file}: no sensor '{sensor}' (known: {', '.join(content)})")
            entry = content[sensor]
            lowest, highest = (float(np.radians(angle)) for angle in entry["elevation_deg"])
            mean, std = (np.array(entry[name], dtype=np.float32) for name in ("mean", "std"))
        except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            raise DataError(
                f"{file}: no scan statistics ({error!r}); see {SHIPPED.name}"
            ) from error
        if mean.shape != (5,) or std.shape != (5,) or not (std > 0).all():
            raise DataError(f"{file}: {sensor}: mean and std take 5 numbers, std above 0")
        if not lowest < highest:
            raise DataError(f"{file}: {sensor}: elevation_deg is [lowest, highest]")
        return cls((lowest, highest), mean, std)

    def adapted_to(self, own: ScanStatistics, *, remission: bool = True) -> ScanStatistics:
        """A network's statistics for the sensor whose own are given: see `adapted`."""
        mean = adapted(self.mean, own.mean, remission=remission)
        std = adapted(self.std, own.std, remission=remission)
        return ScanStatistics(own.elevation_rad, mean, std)

    def written_to(self, text: str, sensor: str, measured_on: str) -> str:
        """The text of a statistics file with the entry `sensor` added, or replaced where it is.

        All else stays as it is, comments too, but for those among the entry's old figures. Raises
        ValueError where the text is no block of entries.
        """
        lowest, highest = np.degrees(self.elevation_rad)
        rows = [
            f"measured_on: {_plain(measured_on)}",
            f"elevation_deg: [{lowest:.1f}, {highest:.1f}]",
            f"mean: [{', '.join(f'{value:.4g}' for value in self.mean)}]",
            f"std: [{', '.join(f'{value:.4g}' for value in self.std)}]",
        ]
        head, gap = f"{_plain(sensor)}:\n  ", "\n  "
        try:
            root = yaml.compose(text, Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            raise ValueError(f"is no YAML ({error})") from error
        if root is None:
            return text + head + gap.join(rows) + "\n"
        if not isinstance(root, yaml.MappingNode) or root.flow_style:
            raise ValueError("holds no block of entries by the sensor's name")
        for key, value in root.value:
            if key.value == sensor:
                start = key.start_mark.index
                if isinstance(value, yaml.MappingNode) and not value.flow_style:
                    start = value.start_mark.index
                    head, gap = "", "\n" + " " * value.start_mark.column
                return text[:start] + head + gap.join(rows) + text[_end(value) :]
        return text + ("" if text.endswith("\n") else "\n") + head + gap.join(rows) + "\n"


def _plain(text: str) -> str:
    """A text as one line of YAML."""
    return yaml.safe_dump(text, width=10_000).partition("\n")[0]


def _end(node: yaml.Node) -> int:
    """Where the text of a node ends; a block's own mark lies behind the comments after it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return int(node.end_mark.index)
