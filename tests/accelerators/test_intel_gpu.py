from __future__ import annotations

import os
from pathlib import Path

import pytest

from accelerators.intel_gpu import why_not


def plug(root: Path, vendor: str, kind: str) -> None:
    card = root / "sys/bus/pci/devices" / vendor
    card.mkdir(parents=True)
    (card / "vendor").write_text(f"{vendor}\n")
    (card / "class").write_text(f"{kind}\n")


def test_a_machine_without_an_intel_gpu_is_told_so(tmp_path: Path) -> None:
    plug(tmp_path, "0x10de", "0x030000")  # another maker's
    plug(tmp_path, "0x8086", "0x020000")  # a network card of Intel
    assert why_not(tmp_path) == "this machine has no Intel GPU; name another device"


def test_each_step_that_is_missing_is_named_in_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug(tmp_path, "0x8086", "0x030000")
    assert "no kernel driver" in why_not(tmp_path)
    (tmp_path / "dev/dri").mkdir(parents=True)
    (tmp_path / "dev/dri/renderD128").touch()
    assert "install intel-opencl-icd" in why_not(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert "add the user to group render" in why_not(tmp_path)
