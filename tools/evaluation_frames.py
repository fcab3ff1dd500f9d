"""Which predicted frame belongs to which true one, and which of its points the cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from pipeline.errors import DataError
from stages.frames import look, mounted
from stages.kernels.geometry import has_return
from stages.labeled_files import FRAMES, LabeledFrame
from stages.sinks.labels import frame_of
from stages.sources.kitti_layouts import LIDAR, Drive, open_drive
from stages.types import Calibration

#: Digits of a stamp as our sinks name files by it.
STAMP_DIGITS = 20

#: Where SemanticKITTI keeps labels within a sequence.
SUBFOLDERS = ("labels", "predictions")


def pair_frames(
    prediction: Path, truth: Path, rate_hz: float
) -> tuple[list[tuple[Path, Path]], int]:
    """Predicted and true files of the same frame, in order; how many true ones are left over.

    A frame is known by its number or name; files named by stamps are the frames at `rate_hz`,
    unless both sides are named so. Raises DataError for a prediction without truth.
    """
    if prediction.is_file() and truth.is_file():
        return [(prediction, truth)], 0
    said, true = _files(prediction), _files(truth)
    by_stamp = all(_is_stamp(path) for path in (*said, *true))
    predicted = _keyed(said, None if by_stamp else rate_hz)
    known = _keyed(true, None if by_stamp else rate_hz)
    missing = [path for key, path in predicted.items() if key not in known]
    if missing:
        raise DataError(
            f"{missing[0]}: no truth for it in {truth} ({len(missing)} of {len(predicted)} frames "
            f"have none; it holds {true[0].name} to {true[-1].name}; --rate-hz numbers stamps)"
        )
    pairs = [(path, known[key]) for key, path in predicted.items()]
    return pairs, len(known) - len(pairs)


@dataclass(frozen=True, slots=True)
class CameraView:
    """What cameras see of scans."""

    calibration: Calibration
    cameras: Sequence[str]
    drive: Drive | None  #: where the points of a label file come from
    rate_hz: float

    @classmethod
    def open(
        cls,
        recording: Path | None,
        calibration: Path | None,
        cameras: Sequence[str],
        rate_hz: float,
    ) -> CameraView | None:
        """None without a recording or a calibration. Raises DataError."""
        if recording is None and calibration is None:
            return None
        drive = None if recording is None else open_drive(recording)
        if calibration is not None:
            sensors = _read_calibration(calibration)
        else:
            assert drive is not None
            sensors = drive.read_calibration()
        for camera in cameras:
            sensors.camera(camera)
        chosen = tuple(cameras) or sensors.cameras()
        if not chosen:
            raise DataError(f"{calibration or recording}: its calibration has no camera")
        return cls(sensors, chosen, drive, rate_hz)

    def sees(self, frame: LabeledFrame, path: Path) -> NDArray[np.bool_]:
        """Which points (n,) lie in the image of any camera. Raises DataError."""
        points, sensor = frame.points, frame.sensor or LIDAR
        if points is None:
            if self.drive is None:
                raise DataError(
                    f"{path}: says nothing of where its points are; give the --recording, or "
                    "write npz instead"
                )
            number = _key(path, self.rate_hz)
            if number not in self.drive.scans:
                raise DataError(f"{path}: the recording has no scan {number}")
            points = self.drive.read_scan(self.drive.scans[int(number)])[0]
        if points.shape != (*frame.labels.shape, 3):
            raise DataError(f"{path}: {frame.labels.size} labels for {len(points)} points")
        visible = np.zeros(len(points), dtype=np.bool_)
        usable = has_return(points, 0.0)
        for camera in self.cameras:
            chain = mounted(self.calibration, camera, sensor)
            view = look(self.calibration.camera(camera), points, usable, chain)
            visible[view.index] = True
        return visible


def _read_calibration(path: Path) -> Calibration:
    """The calibration block of a YAML file, per sensor as in a graph file."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        block = content["calibration"]
        if "use" in block:
            raise DataError(
                f"{path}: its calibration comes from {block['use']}; give the --recording instead"
            )
        return Calibration.parse(block)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: holds no block 'calibration' of sensors ({error})") from None


def _files(folder: Path) -> list[Path]:
    """The labeled frames of a folder, by name. Raises DataError for none or several kinds."""
    if folder.is_file():
        return [folder]
    found = sorted(path for path in folder.glob("*") if path.suffix in FRAMES)
    if not found:
        below = [folder / name for name in SUBFOLDERS if (folder / name).is_dir()]
        if not below:
            raise DataError(f"{folder}: holds no labels ({', '.join(FRAMES)})")
        return _files(below[0])
    kinds = sorted({path.suffix for path in found})
    if len(kinds) > 1:
        raise DataError(f"{folder}: holds {' and '.join(kinds)} files; keep one kind per folder")
    return found


def _keyed(files: Sequence[Path], rate_hz: float | None) -> dict[int | str, Path]:
    keyed: dict[int | str, Path] = {}
    for path in files:
        key = _key(path, rate_hz)
        if key in keyed:
            raise DataError(
                f"{path}: is frame {key} as {keyed[key].name} is; give the --rate-hz of the run"
            )
        keyed[key] = path
    return keyed


def _key(path: Path, rate_hz: float | None) -> int | str:
    if not path.stem.isdecimal():
        return path.stem
    if rate_hz is not None and _is_stamp(path):
        return frame_of(int(path.stem), rate_hz)
    return int(path.stem)


def _is_stamp(path: Path) -> bool:
    return path.stem.isdecimal() and len(path.stem) == STAMP_DIGITS
