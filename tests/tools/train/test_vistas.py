"""Mapillary Vistas in its layout, sound and broken."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from pipeline.errors import DataError
from tools.train.readers.vistas import read_vistas
from tools.train.segment import read_images

SKY, ROAD, VEHICLE = 8, 3, 13


def palette_png(ids: np.ndarray) -> bytes:
    """A PNG with a palette, as the set has them; OpenCV cannot write one."""
    height, width = ids.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    colors = bytes(np.random.default_rng(0).integers(0, 255, 3 * 66, np.uint8))
    rows = b"".join(b"\0" + row.tobytes() for row in ids.astype(np.uint8))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"PLTE", colors)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def vistas(folder: Path, labels: str = "labels", size: tuple[int, int] = (60, 80)) -> Path:
    """Two images of sky (27), road (13), a car (55) and the own vehicle (64)."""
    ids = np.full(size, 27, np.uint8)
    ids[size[0] // 2 :] = 13
    ids[size[0] // 2 : size[0] // 2 + 10, 20:40] = 55
    ids[-4:] = 64
    for name in ("a", "b"):
        (folder / "training/images").mkdir(parents=True, exist_ok=True)
        (folder / "training" / labels).mkdir(parents=True, exist_ok=True)
        picture = np.full((*size, 3), 90, np.uint8)
        cv2.imwrite(str(folder / f"training/images/{name}.jpg"), picture)
        (folder / "training" / labels / f"{name}.png").write_bytes(palette_png(ids))
    return folder


@pytest.mark.parametrize("labels", ["labels", "v1.2/labels"])
def test_ids_behind_a_palette_become_our_classes(labels: str, tmp_path: Path) -> None:
    images = read_vistas(vistas(tmp_path, labels))
    assert len(images) == 2
    classes = images[0].classes
    assert np.unique(classes).tolist() == [0, ROAD, SKY, VEHICLE]
    assert np.count_nonzero(classes == VEHICLE) == 200
    assert (classes[-4:] == 0).all()  # the own vehicle is no class
    assert images[0].pixels.shape == (60, 80, 3)


def test_large_images_are_reduced_and_labels_stay_ids(tmp_path: Path) -> None:
    one = read_vistas(vistas(tmp_path, size=(900, 2400)))[0]
    assert one.pixels.shape == (450, 1200, 3)
    assert np.unique(one.classes).tolist() == [0, ROAD, SKY, VEHICLE]


def test_of_many_images_some_are_taken_evenly(tmp_path: Path) -> None:
    assert len(read_vistas(vistas(tmp_path), most=1)) == 1


def test_the_image_network_learns_from_it(tmp_path: Path) -> None:
    assert len(read_images(vistas(tmp_path))) == 2


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda f: (f / "training/images/b.jpg").unlink(), "b.png: its image b.jpg is missing"),
        (lambda f: (f / "training/labels/b.png").write_bytes(b"no"), "b.png: is no PNG"),
        (
            lambda f: (f / "training/labels/b.png").write_bytes(palette_png(np.full((60, 80), 99))),
            "b.png: label set 'mapillary' has no class 99",
        ),
        (
            lambda f: (f / "training/labels/b.png").write_bytes(palette_png(np.full((9, 9), 13))),
            "b.png: 9 x 9 labels for another image",
        ),
        (
            lambda f: [one.unlink() for one in f.glob("training/labels/*")],
            "the testing part are not given",
        ),
    ],
)
def test_a_broken_set_is_said_with_the_file(broken, said: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder = vistas(tmp_path)
    broken(folder)
    with pytest.raises(DataError, match=said):
        read_vistas(folder)
