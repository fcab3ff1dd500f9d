"""The tables and figures that can be made anew."""

from __future__ import annotations

from enum import StrEnum


class PaperTable(StrEnum):
    """By the paper's numbers, and the one on real data."""

    SEGMENTATION = "3"
    PROPAGATION = "4"
    ABLATION = "5"
    MAPS = "6"
    REAL = "real"


class PaperFigure(StrEnum):
    """By the paper's numbers."""

    VIEW = "5"
    WINDOWS = "6"
    MAPS = "13"
    STILL = "14"
    SECOND = "15"
