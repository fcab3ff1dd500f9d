"""`overflight evaluate`: what a run said against what is true, and how sharp its map is."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from pipeline.errors import DataError
from stages.evaluation_groups import load_groups
from stages.kernels.confusion_picture import draw_confusion
from stages.kernels.evaluation import (
    agreement,
    group_columns,
    labels_at,
    scan_confusion,
    scan_mean,
)
from stages.kernels.metrics import WIDTH, merge_groups
from stages.kernels.neighbors import Cubes, nearest
from stages.kernels.render import encode_png
from stages.kernels.sharpness import sharpness
from stages.labeled_files import LabeledMap, LabelSet, holds_map, read_frame, read_map
from stages.sinks.whole_file import whole_file
from stages.taxonomy import load_taxonomy
from tools.evaluation_frames import CameraView, pair_frames
from tools.evaluation_report import print_verdict

#: What one evaluation looks at: every labeled point, those that the prediction labels at all, those
#: that the cameras see.
ALL, LABELED, IN_VIEW = "all", "labeled", "in_view"


@dataclass(slots=True)
class Tally:
    """Confusion matrices by what they look at, one per frame, and what was left out."""

    matrices: dict[str, list[NDArray[np.int64]]] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)

    def add(
        self,
        truth: NDArray[np.int64],
        predicted: NDArray[np.int64],
        visible: NDArray[np.bool_] | None = None,
    ) -> None:
        """One frame: ids (n,) and which points the cameras see."""
        views = {ALL: None, LABELED: predicted > 0}
        if visible is not None:
            views[IN_VIEW] = visible
        for name, mask in views.items():
            matrix = scan_confusion(truth, predicted, visible=mask)
            self.matrices.setdefault(name, []).append(matrix)


def evaluate_path(
    prediction: Path,
    truth: Path | None,
    *,
    labels: LabelSet,
    truth_labels: LabelSet,
    groups: str | None,
    min_points: float,
    rate_hz: float,
    view: CameraView | None,
    radius_m: float | None,
    voxel_m: float | None,
    as_json: bool,
    png: Path | None,
) -> None:
    """Judge, print, and write what was asked for. Raises DataError naming the file."""
    if min_points < 0:
        raise typer.BadParameter(f"--min-points must be at least 0, not {min_points}")
    names, columns = _columns(groups)
    verdict: dict[str, Any] = {"prediction": str(prediction), "truth": truth and str(truth)}
    if not prediction.exists():
        raise DataError(f"{prediction}: no such file or folder")
    if prediction.is_file() and holds_map(prediction):
        tally = _judge_map(prediction, truth, labels, truth_labels, radius_m, voxel_m)
    elif truth is None:
        raise typer.BadParameter("only a map can be judged without --truth")
    else:
        tally = _judge_frames(prediction, truth, labels, truth_labels, rate_hz, view)
    verdict |= tally.facts
    merged = {
        name: [merge_groups(matrix, columns) for matrix in matrices]
        for name, matrices in tally.matrices.items()
    }
    verdict["views"] = {
        name: _view(matrices, names, min_points) for name, matrices in merged.items()
    }
    if merged:
        total = _sum(merged[ALL])
        verdict["class_names"] = names
        verdict["confusion"] = total[: len(names), : len(names)].tolist()
        if png is not None:
            with whole_file(png) as file:
                file.write(encode_png(draw_confusion(total[: len(names), : len(names)], names)))
    elif png is not None:
        raise typer.BadParameter("--png draws the confusion with the truth; give --truth")
    if as_json:
        typer.echo(json.dumps(_plain(verdict), indent=2))
    else:
        print_verdict(verdict, Console())
        if png is not None:
            typer.echo(f"Written: {png}")


def _judge_frames(
    prediction: Path,
    truth: Path,
    labels: LabelSet,
    truth_labels: LabelSet,
    rate_hz: float,
    view: CameraView | None,
) -> Tally:
    pairs, unpaired = pair_frames(prediction, truth, rate_hz)
    tally = Tally()
    points = unlabeled = 0
    console = Console(stderr=True)
    silent = len(pairs) < 2 or not console.is_terminal
    frames = track(pairs, "judging", console=console, transient=True, disable=silent)
    for said_path, true_path in frames:
        said, true = read_frame(said_path, labels), read_frame(true_path, truth_labels)
        if not _belong(said.labels, true.labels):
            raise DataError(
                f"{said_path}: labels of shape {said.labels.shape}, but its truth {true_path} has "
                f"{true.labels.shape}; is it another frame (--rate-hz), or were points left out?"
            )
        visible = view.sees(said, said_path) if view else None
        tally.add(true.labels.ravel(), said.labels.ravel(), visible)
        points += true.labels.size
        unlabeled += int(np.count_nonzero(true.labels == 0))
    tally.facts = {
        "frames": len(pairs),
        "truth_without_prediction": unpaired,
        "points": points,
        "points_without_truth": unlabeled,
    }
    return tally


def _belong(said: NDArray[np.int64], true: NDArray[np.int64]) -> bool:
    """The same pixels or points; an organized scan may be written row by row."""
    return said.shape == true.shape or (said.size == true.size and 1 in (said.ndim, true.ndim))


def _judge_map(
    prediction: Path,
    truth: Path | None,
    labels: LabelSet,
    truth_labels: LabelSet,
    radius_m: float | None,
    voxel_m: float | None,
) -> Tally:
    """Each annotated point against the nearest voxel within reach; and the map by itself.

    Voxel by voxel where the truth has voxels of the same size and no reach is asked for.
    """
    said = read_map(prediction, labels)
    voxel_m = voxel_m or said.voxel_m
    if voxel_m is None:
        raise DataError(f"{prediction}: does not say how large its voxels are; give --voxel-m")
    tally = Tally(facts={"voxels": len(said.labels), "voxel_m": voxel_m})
    names, reach_m = load_taxonomy().names, voxel_m if radius_m is None else radius_m
    try:
        whole, by_class = sharpness(said.points, said.labels, said.entropy, voxel_m)
        cubes = Cubes.of(said.points, reach_m)
    except ValueError as error:
        raise DataError(f"{prediction}: {error}") from None
    tally.facts["sharpness"] = {"all": asdict(whole)} | {
        names[label]: asdict(measured) for label, measured in by_class.items()
    }
    if truth is None:
        return tally
    true = read_map(truth, truth_labels)
    by_voxel = radius_m is None and true.voxel_m == voxel_m
    row = _same_voxel(said, true, voxel_m) if by_voxel else nearest(cubes, true.points)
    tally.add(true.labels, np.where(row >= 0, said.labels[row], 0) if len(said.labels) else 0 * row)
    tally.facts |= {
        "radius_m": None if by_voxel else reach_m,
        "points": len(true.labels),
        "points_without_truth": int(np.count_nonzero(true.labels == 0)),
        "points_out_of_reach": int(np.count_nonzero((row < 0) & (true.labels > 0))),
    }
    return tally


def _same_voxel(said: LabeledMap, true: LabeledMap, voxel_m: float) -> NDArray[np.int64]:
    """The row (m,) of the voxel of `said` that each of `true` lies in; -1 where there is none."""
    cells = (np.floor(each.points / voxel_m).astype(np.int64) for each in (said, true))
    return labels_at(next(cells), np.arange(1, len(said.labels) + 1), next(cells)) - 1


def _columns(groups: str | None) -> tuple[list[str], NDArray[np.int64]]:
    """Names of the columns, the first for what is in none, and the column of each class id."""
    taxonomy = load_taxonomy()
    if groups is None:
        return list(taxonomy.names), np.arange(WIDTH)
    chosen = load_groups(groups)
    return ["none", *chosen], group_columns(chosen)


def _view(
    matrices: Sequence[NDArray[np.int64]], names: Sequence[str], min_points: float
) -> dict[str, Any]:
    """IoU by class of all frames together, its mean, and the mean over frames."""
    total = _sum(matrices)
    together = agreement(total, min_points=min_points)
    each = scan_mean(matrices, min_points=min_points)
    predicted = total[1:].sum(axis=0)
    return {
        "points": int(together.points.sum()),
        "accuracy": float(np.trace(total[1:, 1:]) / max(together.points.sum(), 1)),
        "mean_iou": together.mean,
        "mean_iou_over_frames": each.mean,
        "classes": {
            name: {
                "points": int(together.points[k]),
                "predicted": int(predicted[k]),
                "iou": float(together.iou[k]),
                "iou_over_frames": float(each.iou[k]),
                "in_mean": bool(together.counted[k]),
            }
            for k, name in enumerate(names)
            if k and (together.points[k] or predicted[k])
        },
    }


def _sum(matrices: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return sum(matrices, np.zeros((WIDTH, WIDTH), dtype=np.int64))


def _plain(value: Any) -> Any:
    """The same for JSON, which knows no NaN."""
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
