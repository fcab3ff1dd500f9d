"""What surfaces are made of: one row of optical and thermal numbers per material.

The numbers are plausible, not calibrated: near-infrared reflectivities after the spectral
libraries' usual values at 865 nm, temperatures of a mild morning in the sun, when persons are the
warmest thing in a street.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Material(IntEnum):
    """Every material; the textures (`textures.py`) branch on it."""

    PLAIN = 0
    ASPHALT = 1
    STREET = 2  #: asphalt with lane markings along its u axis
    ZEBRA = 3
    KERB = 4
    PAVING = 5
    LAWN = 6
    FACADE_BRICK = 7
    FACADE_PLASTER = 8
    ROOF_TILES = 9
    ROOF_FLAT = 10
    BARK = 11
    LEAF = 12
    PAINT = 13  #: glossy, of vehicles
    GLASS = 14
    RUBBER = 15
    METAL = 16
    CLOTH = 17
    SKIN = 18
    HAIR = 19
    WOOD = 20
    STRIPES = 21  #: red and white, of barriers
    LIGHT = 22
    HOOD = 23  #: paint over a warm engine
    GRAVEL = 24


class Row(NamedTuple):
    """One material's numbers."""

    nir: float  #: diffuse reflectivity at the LiDAR's wavelength
    gloss: float  #: share of light mirrored at grazing view
    warm_c: float  #: temperature above the air's, in the shade, degC
    sun_c: float  #: what full sun adds, degC


_ROWS = {
    Material.PLAIN: Row(0.45, 0.02, 1.0, 6.0),
    Material.ASPHALT: Row(0.17, 0.02, 2.0, 6.5),
    Material.STREET: Row(0.17, 0.02, 2.0, 6.5),
    Material.ZEBRA: Row(0.30, 0.02, 2.0, 6.5),
    Material.KERB: Row(0.35, 0.02, 1.5, 4.5),
    Material.PAVING: Row(0.33, 0.02, 1.5, 5.0),
    Material.LAWN: Row(0.52, 0.00, -1.5, 4.0),
    Material.FACADE_BRICK: Row(0.36, 0.01, 1.0, 4.5),
    Material.FACADE_PLASTER: Row(0.55, 0.01, 0.5, 3.0),
    Material.ROOF_TILES: Row(0.33, 0.03, 0.0, 8.0),
    Material.ROOF_FLAT: Row(0.22, 0.01, 0.5, 8.0),
    Material.BARK: Row(0.35, 0.00, 0.0, 3.0),
    Material.LEAF: Row(0.55, 0.03, -2.0, 2.0),
    Material.PAINT: Row(0.40, 0.25, 0.0, 5.0),
    Material.GLASS: Row(0.05, 0.60, -4.0, 2.0),
    Material.RUBBER: Row(0.06, 0.02, 4.0, 5.0),
    Material.METAL: Row(0.50, 0.15, 0.0, 6.0),
    Material.CLOTH: Row(0.50, 0.00, 9.5, 1.5),
    Material.SKIN: Row(0.50, 0.02, 17.0, 0.5),
    Material.HAIR: Row(0.30, 0.02, 11.5, 1.0),
    Material.WOOD: Row(0.45, 0.01, 0.5, 6.0),
    Material.STRIPES: Row(0.60, 0.03, 1.0, 5.0),
    Material.LIGHT: Row(0.60, 0.30, 3.0, 4.0),
    Material.HOOD: Row(0.40, 0.25, 9.0, 5.0),
    Material.GRAVEL: Row(0.30, 0.00, 1.5, 5.0),
}

#: (materials, 4) float32: the columns of `Row`, in the order of `Material`.
MATERIALS: NDArray[np.float32] = np.array([_ROWS[m] for m in Material], dtype=np.float32)
MATERIALS.flags.writeable = False
