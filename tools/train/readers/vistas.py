"""Mapillary Vistas 1.2: training/images/*.jpg beside training/labels/*.png, one id per pixel.

In the package of release 2.0 the labels of 1.2 lie in training/v1.2/labels.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from pipeline.errors import DataError
from stages.labeled_files import LabelSet
from stages.sources.pictures import read_picture
from tools.train.segmenter import LabeledImage

LABELS = ("labels", "v1.2/labels")
#: Of their 12 megapixels: what an 848-pixel camera sees, with room to zoom in.
WIDTH = 1200
#: So many images are held in memory, 2.3 MB each; of more, these are taken evenly.
MOST = 1500


def fits(path: Path) -> bool:
    """The set, or one of its parts."""
    return _part(path) is not None


def read_vistas(path: Path, most: int = MOST) -> list[LabeledImage]:
    """The images of the training part, or of the part named. Raises DataError."""
    part = _part(path)
    if part is None:
        raise DataError(f"{path}: holds no images/ beside labels/ (or v1.2/labels/)")
    folder = next(part / name for name in LABELS if (part / name).is_dir())
    masks = sorted(folder.glob("*.png"))
    if not masks:
        raise DataError(f"{folder}: holds no *.png; the labels of the testing part are not given")
    chosen = np.linspace(0, len(masks) - 1, min(most, len(masks))).round().astype(int)
    return [_read(part / "images", masks[number]) for number in chosen]


def _read(images: Path, mask: Path) -> LabeledImage:
    image = next((p for e in (".jpg", ".png") if (p := images / f"{mask.stem}{e}").is_file()), None)
    if image is None:
        raise DataError(f"{mask}: its image {mask.stem}.jpg is missing in {images}")
    # A palette makes OpenCV give colors; the ids are the palette's indices.
    ids = _indices(mask)
    pixels = read_picture(image)
    if pixels.ndim != 3 or pixels.shape[:2] != ids.shape:
        raise DataError(f"{mask}: {ids.shape[1]} x {ids.shape[0]} labels for another image")
    classes = LabelSet("mapillary").translate(ids, mask).astype(np.uint8)
    size = (WIDTH, round(WIDTH * ids.shape[0] / ids.shape[1]))
    if ids.shape[1] <= WIDTH:
        return LabeledImage(pixels.astype(np.uint8), classes)
    return LabeledImage(
        np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8),
        np.asarray(cv2.resize(classes, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8),
    )


def _indices(path: Path) -> np.ndarray:
    """The palette indices of a PNG (or the values of a gray one), which OpenCV would color in."""
    content = path.read_bytes()
    if content[:8] != b"\x89PNG\r\n\x1a\n":
        raise DataError(f"{path}: is no PNG")
    if content[25] == 3:  # a palette: told to be gray, the same bits are the indices
        content = _as_gray(content)
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 2:
        raise DataError(f"{path}: is no picture of one id per pixel")
    return np.asarray(picture)


def _as_gray(content: bytes) -> bytes:
    """The PNG with color type 0 and without its palette."""
    if content[24] != 8:  # bits of an index
        return content
    out, at = [content[:8]], 8
    while at + 8 <= len(content):
        (length,) = struct.unpack(">I", content[at : at + 4])
        kind, data = content[at + 4 : at + 8], content[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            data = data[:9] + b"\x00" + data[10:]
        if kind not in (b"PLTE", b"tRNS"):
            check = struct.pack(">I", zlib.crc32(kind + data))
            out.append(struct.pack(">I", len(data)) + kind + data + check)
        at += 12 + length
    return b"".join(out)


def _part(path: Path) -> Path | None:
    for part in (path, path / "training"):
        if (part / "images").is_dir() and any((part / name).is_dir() for name in LABELS):
            return part
    return None
