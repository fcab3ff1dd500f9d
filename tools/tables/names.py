"""The tables and figures that can be made anew."""

from __future__ import annotations

from enum import StrEnum


class PaperTable(StrEnum):
    """By the paper's numbers; a second iteration; the one on real data."""

    SEGMENTATION = "3"
    PROPAGATION = "4"
    ABLATION = "5"
    MAPS = "6"
    SECOND = "second"
    REAL = "real"


class PaperFigure(StrEnum):
    """By the paper's numbers."""

    VIEW = "5"
    WINDOWS = "6"
    UNSEEN = "12"
    MAPS = "13"
    STILL = "14"
    SECOND = "15"
    LONG = "16"
    DISASTER = "17"
    DAYLIGHT = "18"
