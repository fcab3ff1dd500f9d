"""Gain control of a thermal camera that sends its raw 16 bit."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import StageError
from pipeline.message import Message
from pipeline.stage import Stage
from stages.kernels.thermal import (
    apply_table,
    equalize_locally,
    histogram,
    linear_table,
    plateau_table,
    quantiles,
)
from stages.types import Image


class ThermalAgc(Stage):
    """16-bit thermal images as 8-bit ones; an 8-bit image passes through as it is.

    Modes: `linear` stretches the range between the 1 % and 99 % quantiles, `plateau` equalizes the
    histogram with bounded bins (as thermal cameras do by themselves), `clahe` stretches and then
    equalizes locally. `linear` and `clahe` keep the temperature's order within the frame's range,
    or within a neighborhood; `plateau` keeps it everywhere and shows most detail where most pixels
    are. Gains follow the scene slowly, so that a warm object that enters does not make it flicker.
    """

    def __init__(
        self,
        *,
        mode: Literal["linear", "plateau", "clahe"] = "linear",
        follow: float = 0.1,
        plateau: float = 0.07,
        max_gain: float = 4.0,
        clip: float = 3.0,
        tiles: int = 8,
    ) -> None:
        """`follow`: by which part the gain moves to the newest frame's, 1 = at once. `plateau`: the
        most that one count weighs, as a part of all pixels. `max_gain`: the most gray levels that
        one count may become. `clip` and `tiles`: CLAHE's contrast limit and tiles per side.
        """
        if mode not in ("linear", "plateau", "clahe"):
            raise ValueError(f"mode must be linear, plateau or clahe, not '{mode}'")
        if not 0 < follow <= 1 or not 0 < plateau <= 1:
            raise ValueError("follow and plateau must be above 0 and at most 1")
        if not max_gain > 0 or not clip > 0 or tiles < 1:
            raise ValueError("max_gain and clip must be above 0, tiles at least 1")
        self._mode = mode
        self._follow = follow
        self._plateau = plateau
        self._max_gain = max_gain
        self._clip = clip
        self._tiles = tiles
        self._state: NDArray[np.floating] | None = None  # range (2,) or table (65536,)

    def process(self, image: Message[Image]) -> Image:
        raw = image.payload.data
        if raw.dtype == np.uint8:
            return image.payload
        if raw.dtype != np.uint16 or raw.ndim != 2:
            raise StageError(
                f"camera '{image.payload.camera}' gives {raw.dtype} images of shape {raw.shape}; "
                "a thermal image is (height, width) uint8 or uint16"
            )
        counts = np.asarray(raw, dtype=np.uint16)
        frame = apply_table(counts, self._table(counts))
        if self._mode == "clahe":
            frame = equalize_locally(frame, self._clip, self._tiles)
        return Image(frame, image.payload.camera)

    def _table(self, raw: NDArray[np.uint16]) -> NDArray[np.float32]:
        counts = histogram(raw)
        if self._mode == "plateau":
            return self._followed(plateau_table(counts, self._plateau, self._max_gain))
        span = quantiles(counts, 0.01, 0.99)
        if span is None:  # nothing but dead pixels: what was seen before stays
            return linear_table(0.0, 0.0) if self._state is None else linear_table(*self._state)
        low, high = self._followed(np.array(span, dtype=np.float64))
        return linear_table(low, high)

    def _followed(self, newest: NDArray[np.floating]) -> NDArray[np.floating]:
        """The gain, moved by `follow` to the newest frame's; the first frame sets it."""
        if self._state is None:
            self._state = newest
        else:
            self._state = self._state + self._follow * (newest - self._state)
        return self._state
