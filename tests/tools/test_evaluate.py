"""The judgement through the command, on files as runs leave them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.message import Message
from pipeline.recording.codec import PAYLOAD
from pipeline.recording.mcap import McapWriter
from stages.codecs.registry import codec_of
from stages.labels import LabeledVoxels, Labels
from stages.sinks.npz import WriteNpz
from stages.sinks.ply import WritePly
from stages.types import Cloud, SemanticVoxels

Overflight = Callable[..., Any]

ROAD, PERSON, VEHICLE = 3, 5, 13

#: A LiDAR-only graph whose "network" knows the truth.
ORACLE = """\
overflight: 1
graph: oracle
stages:
  lidar: {use: stages.sources.kitti:KittiScans, options: {path: RECORDING}}
  truth: {use: my_oracle:Oracle, options: {folder: RECORDING/labels}, inputs: {scan: lidar}}
  labels:
    use: stages.sinks.labels:WriteLabels
    options: {folder: $out/labels, label_set: semantickitti}
    inputs: {cloud: {from: truth, queue: {policy: block, size: 2}}}
  clouds:
    use: stages.sinks.npz:WriteNpz
    options: {folder: $out/clouds}
    inputs: {message: {from: truth, queue: {policy: block, size: 2}}}
"""
MY_ORACLE = """\
from pathlib import Path
import numpy as np
from pipeline.message import Message
from pipeline.stage import Stage
from stages.taxonomy import load_taxonomy
from stages.types import Cloud, Scan

class Oracle(Stage):
    '''Says the truth of a scan.'''

    def __init__(self, *, folder: Path) -> None:
        self.files = sorted(Path(folder).glob("*.label"))

    def process(self, scan: Message[Scan]) -> Cloud:
        raw = np.fromfile(self.files[round(scan.stamp / 1e8)], "<u4") & 0xFFFF
        label = load_taxonomy().translate("semantickitti", raw)
        log_scores = np.full((len(raw), 16), -9, np.float32)
        log_scores[np.arange(len(raw)), label] = 0
        return Cloud(scan.payload.points, log_scores, label > 0, None, "lidar")
"""
CAMERA = """\
calibration:
  lidar: {base_from_sensor: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
  rgb:
    base_from_sensor: [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
    camera: {size: [100, 80], fx: 50, fy: 50, cx: 50, cy: 40}
"""


def label_file(path: Path, *ids: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.array(ids, "<u4").tofile(path)


def judged(answer: Any) -> dict[str, Any]:
    assert answer.code == 0, answer.err
    return dict(json.loads(answer.out))


@pytest.mark.slow
def test_the_truth_run_through_a_graph_is_right_about_every_class(
    overflight: Overflight, tmp_path: Path, shared: Path
) -> None:
    recording = shared / "data" / "semantickitti_00"
    (tmp_path / "my_oracle.py").write_text(MY_ORACLE)
    (tmp_path / "oracle.yaml").write_text(ORACLE.replace("RECORDING", str(recording)))
    assert overflight("run", "oracle.yaml", "--speed", "max", "--quiet").code == 0
    truth = ("--truth", recording, "--truth-labels", "semantickitti", "--json")
    as_labels = ("out/labels", "--labels", "semantickitti")
    for prediction in (as_labels, ("out/clouds",)):
        verdict = judged(overflight("evaluate", *prediction, *truth))
        classes = verdict["views"]["all"]["classes"]
        assert verdict["frames"] == 3
        assert len(classes) >= 8
        assert {row["iou"] for row in classes.values()} == {1.0}
        assert verdict["views"]["all"]["mean_iou"] == 1.0
        assert verdict["views"]["all"]["points"] + verdict["points_without_truth"] == 373_751
    (tmp_path / "camera.yaml").write_text(CAMERA)
    seen = ("--calibration", "camera.yaml", "--recording", recording)
    in_view = [
        judged(overflight("evaluate", *prediction, *truth, *seen))["views"]["in_view"]
        for prediction in (as_labels, ("out/clouds",))
    ]
    assert in_view[0] == in_view[1]
    assert in_view[0]["mean_iou"] == 1.0
    assert 0.05 < in_view[0]["points"] / classes["road"]["points"] < 1


def test_iou_is_counted_over_frames_together_and_one_by_one(
    overflight: Overflight, tmp_path: Path
) -> None:
    for frame, (true, said) in enumerate(
        [
            ([ROAD] * 10, [ROAD] * 10),
            ([ROAD] * 8 + [0, PERSON], [ROAD] * 4 + [VEHICLE] * 4 + [5, 0]),
        ]
    ):
        label_file(tmp_path / f"truth/labels/{frame:06d}.label", *true)
        label_file(tmp_path / f"said/{frame:06d}.label", *said)
    label_file(tmp_path / "truth/labels/000002.label", ROAD)
    verdict = judged(overflight("evaluate", "said", "--truth", "truth", "--json"))
    every, labeled = verdict["views"]["all"], verdict["views"]["labeled"]
    assert every["classes"]["road"]["iou"] == pytest.approx(14 / 18)
    assert every["classes"]["road"]["iou_over_frames"] == pytest.approx((1 + 0.5) / 2)
    assert every["classes"]["person"]["iou"] == 0
    assert labeled["classes"].keys() == {"road", "vehicle"}, "the person was not labeled at all"
    assert verdict["truth_without_prediction"] == 1
    assert verdict["points_without_truth"] == 1
    assert verdict["confusion"][ROAD][VEHICLE] == 4
    table = overflight("evaluate", "said", "--truth", "truth", "--min-points", "2").out
    assert "mean of frames" in table
    assert "1 true frames have no prediction." in table
    assert "Too few points for the mean: person, vehicle." in table


def test_groups_and_the_picture(overflight: Overflight, tmp_path: Path) -> None:
    label_file(tmp_path / "a.label", ROAD, 4, 6, 2)
    label_file(tmp_path / "b.label", 4, ROAD, PERSON, 2)
    (tmp_path / "mine.yaml").write_text("ways: [road, sidewalk]\npeople: [person, rider]\n")
    for groups in ("paper", "mine.yaml"):
        verdict = judged(
            overflight("evaluate", "a.label", "--truth", "b.label", "--groups", groups, "--json")
        )
        assert verdict["views"]["all"]["mean_iou"] == 1.0
        assert len(verdict["views"]["all"]["classes"]) == 2
    overflight("evaluate", "a.label", "--truth", "b.label", "--png", "deep/confusion.png")
    assert cv2.imread(str(tmp_path / "deep/confusion.png")).shape[2] == 3


def test_clouds_named_by_stamp_are_frames_and_the_camera_judges_apart(
    overflight: Overflight, tmp_path: Path
) -> None:
    points = np.array([[10, 0, 0], [10, 5, 5], [-10, 0, 0]], np.float32)  # the last one behind
    scores = np.zeros((3, 16), np.float32)
    scores[:, ROAD] = 3.0
    cloud = Cloud(points, scores, np.ones(3, bool), None, "lidar")
    WriteNpz(folder=tmp_path / "clouds").process(Message.at(400_000_000, cloud))
    label_file(tmp_path / "truth/000004.label", ROAD, ROAD, PERSON)
    (tmp_path / "camera.yaml").write_text(CAMERA)
    words = ("evaluate", "clouds", "--truth", "truth", "--calibration", "camera.yaml")
    verdict = judged(overflight(*words, "--json"))
    assert verdict["views"]["in_view"]["mean_iou"] == 1.0
    assert verdict["views"]["in_view"]["points"] == 2
    assert verdict["views"]["all"]["classes"]["road"]["iou"] == pytest.approx(2 / 3)
    assert "in camera view" in overflight(*words).out
    assert "calibration of 'lidar' has no camera" in overflight(*words, "--camera", "lidar").err


def test_masks_are_judged_pixel_by_pixel(overflight: Overflight, tmp_path: Path) -> None:
    true, said = np.full((4, 5), ROAD, np.uint8), np.full((4, 5), ROAD, np.uint8)
    said[0], true[3, 4] = PERSON, 255
    for folder, mask in (("truth", true), ("said", said)):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "000000.png"), mask)
    words = ("evaluate", "said", "--truth", "truth")
    assert "has no class 255" in overflight(*words).err
    verdict = judged(overflight(*words, "--ignore", 255, "--json"))
    assert verdict["views"]["all"]["classes"]["road"]["iou"] == pytest.approx(14 / 19)


def test_the_truth_of_a_simulated_flight_judges_its_clouds_and_maps(
    overflight: Overflight, tmp_path: Path
) -> None:
    scores = np.zeros((6, 16), np.float32)
    scores[:, ROAD] = 3.0
    cloud = Cloud(
        np.ones((6, 3), np.float32), scores, np.ones(6, bool), None, "lidar", None, (2, 3)
    )
    classes = np.array([[ROAD, ROAD, 0], [ROAD, PERSON, ROAD]], np.uint8)
    still = LabeledVoxels(0.25, np.array([[0, 0, 0], [1, 0, 0]], np.int32), classes[1, :2])
    for folder, payload in (
        ("clouds", cloud),
        ("truth", Labels(classes, np.zeros((2, 3), np.uint16), "lidar")),
        ("map", voxels([ROAD, ROAD])),
        ("still", still),
    ):
        WriteNpz(folder=tmp_path / folder).process(Message.at(123_456_789, payload))
    verdict = judged(overflight("evaluate", "clouds", "--truth", "truth", "--json"))
    assert verdict["views"]["all"]["classes"]["road"]["iou"] == pytest.approx(4 / 5)
    name = "00000000000123456789.npz"
    words = ("evaluate", f"map/{name}", "--truth", f"still/{name}", "--json")
    assert judged(overflight(*words))["views"]["all"]["accuracy"] == 0.5


def voxels(labels: list[int], x: float = 0.1) -> SemanticVoxels:
    positions = np.array([[x + 0.25 * i, 0.1, 0.1] for i in range(len(labels))], np.float32)
    scores = np.zeros((len(labels), 16), np.float32)
    scores[np.arange(len(labels)), labels] = 5.0
    indices = np.floor(positions / 0.25).astype(np.int32)
    return SemanticVoxels(0.25, indices, positions, scores, np.ones(len(labels), np.int32))


def test_a_map_is_judged_by_its_voxel_nearest_to_each_annotated_point(
    overflight: Overflight, tmp_path: Path
) -> None:
    sink = WritePly(path=tmp_path / "map.ply")
    sink.process(Message.at(0, voxels([ROAD, ROAD, VEHICLE])))
    sink.close()
    places = [[0.12, 0.1, 0.1], [0.4, 0.1, 0.1], [0.55, 0.1, 0.1], [9, 9, 9], [0.1, 0.1, 0.1]]
    np.savez(tmp_path / "annotated.npz", points=places, label=[ROAD, ROAD, ROAD, PERSON, 0])
    words = ("evaluate", "map.ply", "--truth", "annotated.npz")
    verdict = judged(overflight(*words, "--json"))
    assert verdict["views"]["all"]["classes"]["road"]["iou"] == pytest.approx(2 / 3)
    assert verdict["views"]["all"]["classes"]["person"]["iou"] == 0
    assert "person" not in verdict["views"]["labeled"]["classes"]
    assert (verdict["points_out_of_reach"], verdict["points_without_truth"]) == (1, 1)
    near = judged(overflight(*words, "--json", "--radius-m", "0.01"))
    assert near["points_out_of_reach"] == 4
    assert "have no voxel within 0.25 m (misses)" in overflight(*words).out


def test_voxels_of_the_same_size_are_judged_voxel_by_voxel(
    overflight: Overflight, tmp_path: Path
) -> None:
    sink = WritePly(path=tmp_path / "map.ply")
    sink.process(Message.at(0, voxels([ROAD, VEHICLE], x=0.24)))  # at the far end of voxels 0 and 1
    sink.close()
    indices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], dtype=np.int32)  # near those of 1 and 2
    true = LabeledVoxels(0.25, indices, np.array([ROAD, VEHICLE, ROAD], dtype=np.uint8))
    with McapWriter(tmp_path / "flight.mcap") as file:
        message = Message.at(0, true)
        codec = codec_of(true)
        file.add_channel("truth/map", codec.schema, {PAYLOAD: "LabeledVoxels"})
        file.write("truth/map", codec.encode(message), received=0, stamp=0)
    words = ("evaluate", "map.ply", "--truth", "flight.mcap")
    verdict = judged(overflight(*words, "--json"))
    assert verdict["views"]["labeled"]["accuracy"] == 1.0
    assert (verdict["points_out_of_reach"], verdict["radius_m"]) == (1, None)
    assert "1 have no voxel of theirs (misses)" in overflight(*words).out
    near = judged(overflight(*words, "--json", "--radius-m", "0.25"))
    assert near["views"]["labeled"]["accuracy"] < 1.0


def test_a_map_alone_is_measured(overflight: Overflight, tmp_path: Path) -> None:
    sink = WritePly(path=tmp_path / "map.ply")
    sink.process(Message.at(0, voxels([VEHICLE] * 12)))
    sink.close()
    measured = judged(overflight("evaluate", "map.ply", "--json"))["sharpness"]
    assert (measured["all"]["voxels"], measured["vehicle"]["blobs"]) == (12, 1)
    assert measured["vehicle"]["thickness_m"] is None, "a line of voxels spans no surface"
    out = overflight("evaluate", "map.ply").out
    assert "thickness" in out
    assert "12" in out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("nowhere",), "nowhere: no such file or folder"),
        (("said",), "only a map can be judged without --truth"),
        (("said", "--truth", "empty"), "empty: holds no labels (.label, .npz, .png)"),
        (
            ("said", "--truth", "few"),
            "000001.label: no truth for it in few (1 of 2 frames have none",
        ),
        (
            ("said", "--truth", "short"),
            "labels of shape (2,), but its truth short/000000.label has",
        ),
        (("said", "--truth", "mixed"), "mixed: holds .label and .png files"),
        (("said", "--truth", "raw"), "label set 'overflight' has no class 40; name the file's own"),
        (("said", "--truth", "said", "--labels", "semantikitti"), "did you mean 'semantickitti'?"),
        (("said", "--truth", "said", "--groups", "papre"), "no grouping 'papre'"),
        (("said", "--truth", "said", "--recording", "few"), "few: no drive found"),
        (
            ("said", "--truth", "said", "--calibration", "c.yaml"),
            "says nothing of where its points",
        ),
        (("plain.npz",), "plain.npz: does not say how large its voxels are; give --voxel-m"),
        (("plain.npz", "--voxel-m", "1", "--png", "a.png"), "give --truth"),
        (("said", "--truth", "said", "--min-points", "-1"), "--min-points must be at least 0"),
    ],
)
def test_a_mistake_is_one_sentence_with_a_way_out(
    overflight: Overflight, tmp_path: Path, words: tuple[str, ...], what: str
) -> None:
    for folder, ids in {"said": (3, 3), "few": (3, 3), "short": (3,), "raw": (40, 3)}.items():
        label_file(tmp_path / folder / "000000.label", *ids)
        if folder != "few":
            label_file(tmp_path / folder / "000001.label", *ids)
    label_file(tmp_path / "mixed/000000.label", 3)
    (tmp_path / "mixed/000001.png").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "c.yaml").write_text(CAMERA)
    np.savez(tmp_path / "plain.npz", positions=np.zeros((1, 3)), labels=np.array([3]))
    answer = overflight("evaluate", *words)
    assert answer.code == 2
    told = " ".join(answer.err.replace("│", " ").split())  # the command frames what typer says
    assert what in told
    assert "Traceback" not in answer.err


def test_stamps_at_another_rate_are_said(overflight: Overflight, tmp_path: Path) -> None:
    cloud = Cloud(
        np.ones((1, 3), np.float32), np.zeros((1, 16), np.float32), np.ones(1, bool), None, "l"
    )
    sink = WriteNpz(folder=tmp_path / "clouds")
    for stamp in (0, 50_000_000):
        sink.process(Message.at(stamp, cloud))
    for frame in range(3):
        label_file(tmp_path / f"truth/{frame:06d}.label", 0)
    words = ("evaluate", "clouds", "--truth", "truth")
    assert "give the --rate-hz of the run" in overflight(*words).err
    assert overflight(*words, "--rate-hz", 20).code == 0
    assert overflight("evaluate", "clouds", "--truth", "clouds").code == 0
