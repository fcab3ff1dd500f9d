"""The classes of the fused semantics: names, colors, flags, and the maps from other label sets."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.types import CHANNELS

#: The classes and maps that come with Overflight.
SHIPPED = Path(__file__).with_name("taxonomy.yaml")


@dataclass(frozen=True, slots=True, eq=False)
class Taxonomy:
    """The classes by id (0 is background), at most `CHANNELS`."""

    names: tuple[str, ...]
    colors: NDArray[np.uint8]  #: (classes, 3) RGB
    dynamic: NDArray[np.bool_]  #: (classes,) moves by itself
    ground: NDArray[np.bool_]  #: (classes,) may lie on the ground plane
    maps: Mapping[str, Mapping[str, tuple[int, ...]]]  #: label set -> our class -> its ids

    def __len__(self) -> int:
        return len(self.names)

    def id(self, name: str) -> int:
        """The id of a class; raises ValueError with the nearest name."""
        if name in self.names:
            return self.names.index(name)
        raise ValueError(f"no class '{name}'{_nearest(name, self.names)}")

    def label_map(self, label_set: str) -> NDArray[np.int64]:
        """(greatest id + 1,) our id by the label set's id, -1 where it has no counterpart.

        Raises ValueError for an unknown label set.
        """
        if label_set not in self.maps:
            raise ValueError(f"no label set '{label_set}'{_nearest(label_set, self.maps)}")
        groups = self.maps[label_set]
        ours = np.full(1 + max(max(ids) for ids in groups.values()), -1, dtype=np.int64)
        for name, ids in groups.items():
            ours[list(ids)] = self.id(name)
        return ours

    def translate(self, label_set: str, ids: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Our ids of an array of the label set's ids; -1 where there is no counterpart."""
        ours = self.label_map(label_set)
        known = (ids >= 0) & (ids < len(ours))
        return np.where(known, ours[np.where(known, ids, 0)], -1)


@cache
def load_taxonomy(path: Path = SHIPPED) -> Taxonomy:
    """Read a taxonomy file. Raises DataError with what is wrong in it."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        classes = content["classes"]
        names = tuple(str(entry["name"]) for entry in classes)
        colors = np.array([entry["color"] for entry in classes], dtype=np.uint8).reshape(-1, 3)
        dynamic = np.array([entry.get("dynamic", False) for entry in classes], dtype=np.bool_)
        ground = np.array([entry.get("ground", False) for entry in classes], dtype=np.bool_)
        maps = {
            label_set: {name: tuple(map(int, ids)) for name, ids in groups.items()}
            for label_set, groups in content["maps"].items()
        }
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: not a taxonomy ({error!r}); see {SHIPPED.name}") from error
    if not 1 <= len(names) <= CHANNELS:
        raise DataError(f"{path}: {len(names)} classes; from 1 to {CHANNELS} fit")
    for label_set, groups in maps.items():
        for name in groups:
            if name not in names:
                raise DataError(
                    f"{path}: maps.{label_set}: no class '{name}'{_nearest(name, names)}"
                )
        ids = [number for group in groups.values() for number in group]
        if len(ids) != len(set(ids)):
            raise DataError(f"{path}: maps.{label_set}: an id stands in two classes; keep one")
    colors.flags.writeable = dynamic.flags.writeable = ground.flags.writeable = False
    return Taxonomy(names, colors, dynamic, ground, maps)


def _nearest(word: str, known: Mapping[str, object] | tuple[str, ...]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else f" (known: {', '.join(known)})"
