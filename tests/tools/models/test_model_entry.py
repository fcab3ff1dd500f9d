from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tiny_models import write_onnx, write_tflite

from pipeline.errors import ModelError
from stages.taxonomy import load_taxonomy
from tools.models.entry import Said, entry_of, guess_head, parse_classes, parse_head


def said(kind: str = "scores", **others: Any) -> Said:
    nothing: dict[str, Any] = {
        "head": {"kind": kind},
        "classes": {},
        "outputs": {},
        "color": None,
        "mean": (),
        "std": (),
        "description": "",
        "license": "",
        "source": "",
    }
    return Said(**nothing | others)


def test_a_label_set_is_the_taxonomys_own_map() -> None:
    classes = parse_classes("cityscapes")
    theirs = load_taxonomy().label_map("cityscapes")
    assert classes == {
        number: load_taxonomy().names[ours] for number, ours in enumerate(theirs) if ours >= 0
    }


def test_a_head_is_a_kind_or_a_block_with_settings() -> None:
    assert parse_head("ssd_postprocessed") == {"kind": "ssd_postprocessed"}
    assert parse_head("{kind: label_map, stride: 4}") == {"kind": "label_map", "stride": 4}


def test_a_quantized_input_takes_the_bytes_of_a_picture_as_they_are(shared: Path) -> None:
    folder = shared / "models"
    for file, mean, std in (
        (folder / "coral" / "deeplabv3_mnv2_pascal_quant.tflite", 128, 128),
        (folder / "made" / "fastestdet_coco_352_int8.tflite", 0, 255),
    ):
        (variant,) = entry_of([file], said("label_map"), [folder]).entry["variants"]
        assert (variant.get("mean", [0])[0], variant["std"][0]) == (mean, std)


def test_the_shipped_entries_come_out_of_their_own_files(shared: Path) -> None:
    import yaml

    from accelerators.registry_file import SHIPPED, ModelEntry

    shipped = yaml.safe_load(SHIPPED.read_text())["models"]["detect-rgb-fastestdet"]
    folder = shared / "models"
    files = [folder / one["file"] for one in shipped["variants"]]
    found = ModelEntry.model_validate(
        entry_of(files, said("fastestdet", color="bgr", mean=[0], std=[255]), [folder]).entry
    )
    expected = ModelEntry.model_validate(shipped)
    assert found.input == expected.input
    for one, other in zip(found.variants, expected.variants, strict=True):
        assert (one.kind, one.file, one.sha256) == (other.kind, other.file, other.sha256)
        assert (one.layout, one.mean, one.std) == (other.layout, other.mean, other.std)
        assert one.outputs["grid"].layout == other.outputs["grid"].layout
        assert one.outputs["grid"].shape == other.outputs["grid"].shape


def test_outputs_are_guessed_where_only_one_head_fits(shared: Path) -> None:
    folder = shared / "models"
    for file, kind in (
        ("omz/person-vehicle-bike-detection-2000.FP16-INT8.xml", "detection_output"),
        ("coral/deeplabv3_mnv2_pascal_quant.tflite", "label_map"),
        ("made/ssdlite_mnv2_pedestrian_300_int8.tflite", "ssd"),
        ("coral/automl_video_ondevice/traffic_model.tflite", None),
        ("made/fastestdet_coco_352_int8.tflite", None),
    ):
        assert guess_head(folder / file) == kind, file


def test_files_of_different_sizes_are_not_one_model(shared: Path, tmp_path: Path) -> None:
    write_tflite(tmp_path / "tiny.tflite")
    other = shared / "models" / "fastestdet" / "example" / "onnx-runtime" / "FastestDet.onnx"
    with pytest.raises(ModelError, match=r"FastestDet\.onnx: takes \[352, 352, 3\], .*tiny"):
        entry_of([tmp_path / "tiny.tflite", other], said(), [tmp_path])


def test_a_recurrent_network_has_to_be_written_by_hand(shared: Path) -> None:
    path = shared / "models" / "coral" / "automl_video_ondevice" / "traffic_model.tflite"
    with pytest.raises(ModelError, match="have to be held at a value with 'constants'"):
        entry_of([path], said("ssd_postprocessed"), [path.parent])


def test_what_was_said_is_not_assumed(tmp_path: Path) -> None:
    write_onnx(tmp_path / "tiny.onnx")
    everything = said(
        color="bgr", mean=[1.0], std=[2.0], license="MIT", source="me", classes={0: "road"}
    )
    written = entry_of([tmp_path / "tiny.onnx"], everything, [tmp_path])
    assert written.assumed == ()
    assert written.entry["input"]["color"] == "bgr"
    assert (written.entry["variants"][0]["mean"], written.entry["variants"][0]["std"]) == ([1], [2])
    assert len(entry_of([tmp_path / "tiny.onnx"], said(), [tmp_path]).assumed) == 5
