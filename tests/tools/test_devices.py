from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from accelerators.litert import EdgeTpu
from pipeline.errors import DeviceError
from pipeline.graph.options import device_class
from tools.devices import find_devices

Overflight = Callable[..., Any]


def test_every_device_line_it_shows_is_one_that_a_graph_can_hold() -> None:
    found = find_devices()
    kinds = {one.use.partition(":")[2] for one in found}
    assert kinds >= {"TfliteCpu", "EdgeTpu", "OpenVino", "Onnx"}
    for one in found:
        cls, options = device_class(one.use)
        assert set(one.options) <= {option.name for option in options}
        assert cls(**one.options).probe().available is one.probe.available


def test_what_is_missing_says_why_and_what_to_do() -> None:
    for one in find_devices():
        assert bool(one.probe.reason) is not one.probe.available
        assert bool(one.probe.name) is one.probe.available


def test_the_command_lists_what_is_here_and_what_is_not(overflight: Overflight) -> None:
    answer = overflight("devices")
    assert answer.code == 0
    ready, _, missing = answer.out.partition("Not here")
    assert "{use: accelerators.openvino:OpenVino, device: CPU}" in ready
    if not EdgeTpu().probe().available:
        assert "accelerators.litert:EdgeTpu" in missing
    assert "accelerators.emulated:Emulated" in answer.out


def test_what_to_install_is_printed_letter_by_letter(
    overflight: Overflight, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(backend: str) -> None:
        raise DeviceError("pip install 'overflight[tflite-runtime]'")

    monkeypatch.setattr("accelerators.litert.working_package", absent)
    assert "overflight[tflite-runtime]" in overflight("devices").out


def test_as_json_it_names_the_machine_and_each_device(overflight: Overflight) -> None:
    found = json.loads(overflight("devices", "--json").out)
    assert found["machine"]["cores"] >= 1
    assert set(found["devices"][0]) == {
        *("use", "options", "available", "name", "runtime", "driver", "missing")
    }
