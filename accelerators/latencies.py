"""What networks took on hardware that is not at hand: the tables that ship beside the registry."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

SHIPPED = Path(__file__).resolve().parents[1] / "graphs" / "models" / "latencies.yaml"


def column(name: str) -> Mapping[str, float]:
    """ms per run by model, of ``table.device``. Raises ValueError."""
    tables: Mapping[str, Any] = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    columns: Mapping[str, Mapping[str, float]] = {
        f"{table}.{device}": column
        for table, block in tables.items()
        for device, column in block["devices"].items()
    }
    if name not in columns:
        raise ValueError(f"latencies {name} is no shipped column; known: {', '.join(columns)}")
    return columns[name]
