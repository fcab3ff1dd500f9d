from __future__ import annotations

import os
from pathlib import Path

import pytest

from accelerators.edgetpu_bus import attached, why_not


def plug_usb(root: Path, port: str, ids: tuple[str, str], number: int) -> Path:
    device = root / "sys/bus/usb/devices" / port
    device.mkdir(parents=True)
    (device / "idVendor").write_text(f"{ids[0]}\n")
    (device / "idProduct").write_text(f"{ids[1]}\n")
    (device / "busnum").write_text("2\n")
    (device / "devnum").write_text(f"{number}\n")
    node = root / "dev/bus/usb/002" / f"{number:03}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return node


def plug_pci(root: Path, *, driver: bool) -> None:
    card = root / "sys/bus/pci/devices/0000:01:00.0"
    card.mkdir(parents=True)
    (card / "vendor").write_text("0x1ac1\n")
    (card / "device").write_text("0x089a\n")
    if driver:
        (root / "dev").mkdir(exist_ok=True)
        (root / "dev/apex_0").touch()
        (root / "sys/module/apex").mkdir(parents=True)
        (root / "sys/module/apex/version").write_text("1.2\n")


def test_every_edge_tpu_is_found_under_the_name_that_a_graph_gives_it(tmp_path: Path) -> None:
    first = plug_usb(tmp_path, "1-1", ("1a6e", "089a"), 4)  # before its firmware
    second = plug_usb(tmp_path, "1-2", ("18d1", "9302"), 17)
    plug_usb(tmp_path, "1-3", ("046d", "c077"), 5)  # a mouse
    plug_pci(tmp_path, driver=True)
    found = attached(tmp_path)
    assert [one.name for one in found] == ["usb:0", "usb:1", "pci:0"]
    assert [one.node for one in found[:2]] == [first, second]
    assert [one.driver for one in found] == ["", "", "apex 1.2"]


def test_a_machine_without_one_is_told_to_plug_it_in(tmp_path: Path) -> None:
    assert attached(tmp_path) == ()
    assert why_not(None, tmp_path) == "no Edge TPU on USB or PCIe; plug one in"


def test_a_name_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path) -> None:
    plug_usb(tmp_path, "1-1", ("18d1", "9302"), 4)
    assert why_not("usb:1", tmp_path).startswith("no Edge TPU 'usb:1' here, only usb:0;")
    assert why_not("pci", tmp_path).startswith("no Edge TPU 'pci' here, only usb:0;")


def test_a_card_without_a_driver_is_told_what_to_install(tmp_path: Path) -> None:
    plug_pci(tmp_path, driver=False)
    assert "install gasket-dkms" in why_not("pci:0", tmp_path)
    assert "install gasket-dkms" in why_not(None, tmp_path)
    assert "plug one in" in why_not("usb", tmp_path)


def test_a_device_that_is_there_and_does_not_open_is_in_use(tmp_path: Path) -> None:
    plug_usb(tmp_path, "1-1", ("18d1", "9302"), 4)
    assert "usb:0 does not open; end the process that uses it" in why_not("usb", tmp_path)


def test_a_device_of_another_user_names_the_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = plug_usb(tmp_path, "1-1", ("18d1", "9302"), 4)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    said = why_not(None, tmp_path)
    assert str(node) in said
    assert f"add the user to group {node.group()}" in said
