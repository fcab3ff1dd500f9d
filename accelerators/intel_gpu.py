"""Says why OpenVINO sees no Intel GPU: what the kernel knows of it.

OpenVINO's GPU plugin lists what its OpenCL driver offers and is silent where that is missing.
"""

from __future__ import annotations

import os
from pathlib import Path

_INTEL = "0x8086"
_DISPLAY = "0x03"  #: PCI class of display controllers


def why_not(root: Path = Path("/")) -> str:
    """Why there is no GPU, with the one thing to do; `root` holds ``sys`` and ``dev``."""
    if not any(_is_intel_gpu(card) for card in (root / "sys/bus/pci/devices").glob("*")):
        return "this machine has no Intel GPU; name another device"
    nodes = sorted((root / "dev/dri").glob("renderD*"))
    if not nodes:
        return "the Intel GPU has no kernel driver here; load i915 or xe, into a container /dev/dri"
    if not any(os.access(node, os.R_OK | os.W_OK) for node in nodes):
        return "this user may not open the Intel GPU; add the user to group render and log in again"
    return "the Intel GPU has no OpenCL driver; install intel-opencl-icd"


def _is_intel_gpu(card: Path) -> bool:
    try:
        vendor, kind = (card / "vendor").read_text(), (card / "class").read_text()
    except OSError:
        return False
    return vendor.strip() == _INTEL and kind.startswith(_DISPLAY)
