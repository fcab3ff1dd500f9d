"""Images with boxes drawn by people: a folder in COCO's layout, in the classes of the taxonomy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.sources.pictures import read_picture
from stages.taxonomy import load_taxonomy

#: What data sets call things (lower case, without blanks), and what we do; others are left out.
CATEGORIES: Mapping[str, str] = {
    "person": "person",
    "pedestrian": "person",
    "bicycle": "bicycle",
    "bike": "bicycle",
    "motorcycle": "bicycle",
    "motor": "bicycle",
    "car": "vehicle",
    "bus": "vehicle",
    "truck": "vehicle",
    "vehicle": "vehicle",
    "othervehicle": "vehicle",
}
#: Regions in which nobody may be judged: too small or too crowded for whoever annotated them.
DO_NOT_CARE = ("dontcare", "ignore", "ignoredregion")

#: Where an annotation file may lie in its folder, and the images beside it.
ANNOTATION_FILES = (
    *("ann.json", "annotations.json", "_annotations.coco.json"),
    *("thermal_annotations.json", "coco.json"),  # FLIR ADAS 1 and 2, thermal
    *(f"annotations/instances_{part}2017.json" for part in ("train", "val")),  # COCO
)


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedImage:
    """One image and what is to be seen in it."""

    path: Path  #: its file; of an image of a flight a name alone
    size: tuple[int, int]  #: (width, height)
    boxes: NDArray[np.float32]  #: (n, 4) x0 y0 x1 y1, pixels
    classes: NDArray[np.int64]  #: (n,) ids of the taxonomy, -1 for a region to be ignored
    pixels: NDArray[np.uint8] | None = None  #: where there is no file

    def read(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """The pixels. Raises DataError for a file that cannot be read."""
        return read_picture(self.path) if self.pixels is None else self.pixels

    def without_small(self, min_side_px: float) -> AnnotatedImage:
        """The same with boxes to be ignored where a side is shorter."""
        small = (self.boxes[:, 2:] - self.boxes[:, :2]).min(axis=1) < min_side_px
        return replace(self, classes=np.where(small, -1, self.classes))

    @property
    def ignored(self) -> NDArray[np.bool_]:
        """(n,) which boxes are regions to be ignored."""
        return self.classes < 0


def read_annotated(folder: Path) -> list[AnnotatedImage]:
    """The annotated images of a folder by name. Raises DataError with the file and what is wrong.

    Boxes are COCO's (x, y, width, height), of categories whose names are in `CATEGORIES`; crowds
    count as regions to be ignored.
    """
    file = next((folder / name for name in ANNOTATION_FILES if (folder / name).is_file()), None)
    if file is None:
        raise DataError(
            f"{folder}: holds no {' or '.join(ANNOTATION_FILES)}; give a folder of images with "
            "COCO annotations"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        class_of = _classes({one["id"]: one["name"] for one in content["categories"]})
        by_image: dict[Any, list[Mapping[str, Any]]] = {one["id"]: [] for one in content["images"]}
        for one in content["annotations"]:
            by_image[one["image_id"]].append(one)
        images = [
            _image(_root(file), one, by_image[one["id"]], class_of) for one in content["images"]
        ]
    except (ValueError, KeyError, TypeError, OSError) as error:
        reason = f"{type(error).__name__} {error}"
        raise DataError(f"{file}: is no COCO annotation file ({reason})") from None
    if not images:
        raise DataError(f"{file}: lists no images")
    return sorted(images, key=lambda image: image.path.name)


def _root(file: Path) -> Path:
    """Where the images of an annotation file are: beside it, or in COCO's folder of that part."""
    if file.parent.name != "annotations":
        return file.parent
    part = file.parent.parent / file.stem.removeprefix("instances_")
    return part if part.is_dir() else file.parent.parent


def _classes(names: Mapping[int, str]) -> dict[int, int | None]:
    """Our class id of each category: -1 to be ignored, None where it is left out."""
    taxonomy = load_taxonomy()
    found: dict[int, int | None] = {}
    for number, name in names.items():
        plain = "".join(name.lower().split())
        ours = CATEGORIES.get(plain)
        found[number] = taxonomy.id(ours) if ours else -1 if plain in DO_NOT_CARE else None
    return found


def _image(
    folder: Path,
    entry: Mapping[str, Any],
    annotations: Sequence[Mapping[str, Any]],
    class_of: Mapping[int, int | None],
) -> AnnotatedImage:
    name = entry.get("file_name") or entry["filename"]
    places = (folder / name, folder / "images" / name)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise DataError(f"{folder}: has no image {name}, which its annotations name")
    boxes, classes = [], []
    for one in annotations:
        label = class_of[one["category_id"]]
        if label is not None:
            x, y, width, height = one["bbox"]
            boxes.append((x, y, x + width, y + height))
            classes.append(-1 if one.get("iscrowd") else label)
    return AnnotatedImage(
        path,
        (int(entry["width"]), int(entry["height"])),
        np.array(boxes, dtype=np.float32).reshape(-1, 4),
        np.array(classes, dtype=np.int64),
    )
