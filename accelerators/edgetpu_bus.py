"""Finds the Edge TPUs that are plugged in, and says why one of them does not open.

libedgetpu answers every failure with an empty text, the same for no device, a busy one and a wrong
name. The kernel knows which it is.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: USB ids as (vendor, product): fresh from power-up, and once libedgetpu has sent its firmware.
_USB_IDS = {("1a6e", "089a"), ("18d1", "9302")}
_PCI_ID = ("0x1ac1", "0x089a")


@dataclass(frozen=True, slots=True)
class EdgeTpuDevice:
    """One Edge TPU on a bus."""

    name: str  #: as the graph file and libedgetpu name it: ``usb:0``, ``pci:1``
    node: Path  #: its device file
    accessible: bool  #: this user may open it
    driver: str = ""  #: kernel driver and version where it has one


def attached(root: Path = Path("/")) -> tuple[EdgeTpuDevice, ...]:
    """All Edge TPUs, USB before PCIe; `root` is the folder that holds ``sys`` and ``dev``."""
    nodes = [("usb", node) for node in _usb_nodes(root)]
    nodes += [("pci", node) for node in sorted((root / "dev").glob("apex_*"))]
    counts = dict.fromkeys(("usb", "pci"), 0)
    found = []
    for bus, node in nodes:
        driver = _apex_driver(root) if bus == "pci" else ""
        usable = os.access(node, os.R_OK | os.W_OK)
        found.append(EdgeTpuDevice(f"{bus}:{counts[bus]}", node, usable, driver))
        counts[bus] += 1
    return tuple(found)


def without_driver(root: Path = Path("/")) -> bool:
    """Whether an Edge TPU sits on PCIe and no driver has made a device file for it."""
    cards = (root / "sys/bus/pci/devices").glob("*")
    there = any((_text(card / "vendor"), _text(card / "device")) == _PCI_ID for card in cards)
    return there and not any((root / "dev").glob("apex_*"))


def why_not(device: str | None, root: Path = Path("/")) -> str:
    """Why libedgetpu does not open `device` (None: any), with the one thing to do."""
    found = attached(root)
    wanted = [one for one in found if device is None or _matches(device, one.name)]
    if not wanted and device != "usb" and without_driver(root):
        return "an Edge TPU sits on PCIe without a driver; install gasket-dkms and restart"
    if not found:
        return "no Edge TPU on USB or PCIe; plug one in"
    names = ", ".join(one.name for one in found)
    if not wanted:
        return f"no Edge TPU '{device}' here, only {names}; name that one or leave 'device' out"
    locked = [one for one in wanted if not one.accessible]
    if len(locked) == len(wanted):
        one = locked[0]
        return (
            f"this user may not open the Edge TPU {one.name} ({one.node}); "
            f"add the user to group {_group(one.node)} and log in again"
        )
    return f"the Edge TPU {wanted[0].name} does not open; end the process that uses it"


def is_device(text: str) -> bool:
    """Whether libedgetpu would understand the name."""
    return re.fullmatch(r"(usb|pci)(:\d+)?", text) is not None


def _matches(device: str, name: str) -> bool:
    return name == device or name.partition(":")[0] == device


def _usb_nodes(root: Path) -> Iterator[Path]:
    for device in sorted((root / "sys/bus/usb/devices").glob("*")):
        if (_text(device / "idVendor"), _text(device / "idProduct")) in _USB_IDS:
            bus, number = _text(device / "busnum"), _text(device / "devnum")
            yield root / "dev/bus/usb" / bus.zfill(3) / number.zfill(3)


def _apex_driver(root: Path) -> str:
    return f"apex {_text(root / 'sys/module/apex/version')}".strip()


def _group(node: Path) -> str:
    try:
        return node.group()
    except (KeyError, OSError):
        return "plugdev"


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
