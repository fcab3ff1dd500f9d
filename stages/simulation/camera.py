"""The RGB camera and its depth: sun with shadows, sky light, textures, lens and sensor noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.simulation.hits import FACING, LX, LY, LZ, NX, NY, NZ, PX, PY, PZ, Hits, U, V, resolve
from stages.simulation.materials import MATERIALS, Material
from stages.simulation.noise import bell, chance, fractal_noise, mix, scrambled
from stages.simulation.textures import color_at
from stages.simulation.trace import (
    DX,
    DY,
    DZ,
    NOTHING,
    OX,
    OY,
    OZ,
    PACKET,
    TILE,
    Packet,
    Scene,
    T,
    trace,
)

FAR_M = 400.0
_LEAF, _GLASS = int(Material.LEAF), int(Material.GLASS)
#: How far a sky ray looks: what darkens a spot by its nearness, not the house across the street.
_SKY_RAY_M = 5.0
_SUN = (2.55, 2.32, 1.95)
_SKY = (0.62, 0.78, 1.05)
_GROUND = (0.26, 0.24, 0.20)  #: what the ground throws back up
_DUST = (0.80, 0.70, 0.56)  #: sunlit
DUST_TOP_M = 30.0  #: the dust lies so deep: what a ray to the sky passes of it


@compiled
def sky_color(x: float, y: float, z: float, sun: NDArray[np.float32]) -> Any:
    """Linear radiance of the sky along a unit direction: a gradient, clouds, the sun's glow."""
    up = max(z, 0.0)
    haze = math.exp(-6.0 * up)
    r = 0.30 + 0.62 * haze
    g = 0.52 + 0.46 * haze
    b = 0.98 + 0.08 * haze
    if up > 0.02:
        scale = 1.6 / (up + 0.12)
        cloud = fractal_noise(x * scale, y * scale, 0.03, 5, 211)
        cover = min(max((cloud - 0.50) * 5.0, 0.0), 1.0) * min(1.0, up * 7.0) * 0.85
        lit = 0.86 + 0.55 * (cloud - 0.5)
        r, g, b = (
            r + (lit * 1.08 - r) * cover,
            g + (lit * 1.08 - g) * cover,
            b + (lit * 1.1 - b) * cover,
        )
    toward = max(x * sun[0] + y * sun[1] + z * sun[2], 0.0)
    glow = 0.35 * toward**12 + 6.0 * toward**900
    return r + glow, g + 0.92 * glow, b + 0.75 * glow


_TONES, _WHITE = 2048, 6.0


def _tone_table() -> NDArray[np.float32]:
    """Display values 0..255 of linear radiance 0..`_WHITE`: a soft shoulder, then gamma."""
    linear = np.linspace(0.0, 1.0, _TONES) ** 2 * _WHITE
    return np.asarray(255.0 * (1.0 - np.exp(-1.15 * linear)) ** (1 / 2.2), dtype=np.float32)


_TONE = _tone_table()


@compiled
def _exposed(value: float) -> Any:
    """Linear radiance as a display value 0..255."""
    place = math.sqrt(min(max(value, 0.0), _WHITE) * (1.0 / _WHITE)) * (_TONES - 1.001)
    low = int(place)
    return _TONE[low] + (place - low) * (_TONE[low + 1] - _TONE[low])


@compiled
def render(
    scene: Scene,
    packet: Packet,
    shadow: Packet,
    hits: Hits,
    world_from_camera: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    sun: NDArray[np.float32],
    salt: int,
    noise: float,
    dust: float,
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    things: NDArray[np.uint16],
) -> None:
    """Fill `color` (h, w, 3), `depth` (h, w; z in m, 0 for the sky) and `things` (h, w).

    `intrinsics` are fx fy cx cy (further ones are not used: the images are rectified);
    `noise` scales the sensor's noise; `salt` seeds it; `dust` is its extinction per m.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    rays, look = packet.rays, scene.look
    sunlit = np.empty(PACKET, dtype=np.bool_)
    for top in range(0, height, TILE[0]):
        for left in range(0, width, TILE[1]):
            aim_through_pixels(rays, top, left, world_from_camera, intrinsics)
            trace(scene, packet, False)
            resolve(scene, packet, hits)
            aim_at_sun(hits, rays, shadow.rays, sun)
            trace(scene, shadow, True)
            for k in range(PACKET):
                sunlit[k] = shadow.triangle[k] == NOTHING
            _aim_at_sky(hits, rays, shadow.rays, top, left, salt)
            trace(scene, shadow, True)
            for k in range(PACKET):
                row, column = top + k // TILE[1], left + k % TILE[1]
                if row >= height or column >= width:
                    continue
                open_sky = shadow.triangle[k] == NOTHING
                r, g, b = _radiance(hits, rays, k, look, sun, sunlit[k], open_sky, 1.0 / fx)
                r, g, b = _through_dust(hits, rays, k, dust, r, g, b)
                x, y = (column - cx) / fx, (row - cy) / fy
                vignette = 1.0 / (1.0 + 0.22 * (x * x + y * y))
                bits = scrambled(row, column, salt)
                for channel, value in ((0, r), (1, g), (2, b)):
                    shown = _exposed(value * vignette)
                    # Shot noise grows with the root of the light; gamma turns that about even.
                    shown += noise * (1.6 + 0.006 * (255.0 - shown)) * bell(bits)
                    color[row, column, channel] = np.uint8(min(max(shown + 0.5, 0.0), 255.0))
                    bits = mix(bits)
                things[row, column] = hits.thing[k]
                depth[row, column] = 0.0
                if hits.surface[k] != NOTHING:
                    depth[row, column] = rays[T, k] / math.sqrt(x * x + y * y + 1.0)


@compiled
def aim_through_pixels(
    rays: NDArray[np.float32],
    top: int,
    left: int,
    world_from_camera: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
) -> None:
    """Set the rays from the camera through the pixels of a tile, whose first is (top, left)."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    m = world_from_camera
    for k in range(PACKET):
        x = (left + k % TILE[1] - cx) / fx
        y = (top + k // TILE[1] - cy) / fy
        inverse = 1.0 / math.sqrt(x * x + y * y + 1.0)
        for axis in range(3):
            rays[OX + axis, k] = m[axis, 3]
            rays[DX + axis, k] = (m[axis, 0] * x + m[axis, 1] * y + m[axis, 2]) * inverse
        rays[T, k] = FAR_M


@compiled
def aim_at_sun(
    hits: Hits,
    rays: NDArray[np.float32],
    shadow: NDArray[np.float32],
    sun: NDArray[np.float32],
) -> None:
    """Set the rays `shadow` from the hits toward the sun; none from the sky or from what faces
    away, unless it is a leaf, which shines through."""
    rows = hits.rows
    for k in range(PACKET):
        shadow[T, k] = -1.0
        if hits.surface[k] == NOTHING:
            continue
        toward = rows[NX, k] * sun[0] + rows[NY, k] * sun[1] + rows[NZ, k] * sun[2]
        if toward > 0.0 or hits.material[k] == _LEAF:
            _leave(rows, rays, shadow, k)
            shadow[DX, k], shadow[DY, k], shadow[DZ, k] = sun[0], sun[1], sun[2]
            shadow[T, k] = 150.0


@compiled
def _aim_at_sky(
    hits: Hits,
    rays: NDArray[np.float32],
    shadow: NDArray[np.float32],
    top: int,
    left: int,
    salt: int,
) -> None:
    """Set a ray from each hit into the half of the sky before it, at random about the middle."""
    rows = hits.rows
    for k in range(PACKET):
        shadow[T, k] = -1.0
        if hits.surface[k] == NOTHING:
            continue
        bits = scrambled(top + k // TILE[1], left + k % TILE[1], salt + 1)
        angle = (bits & np.uint32(0xFFFF)) * (6.2831853 / 65536.0)
        reach = 0.7 * math.sqrt((bits >> np.uint32(16)) * (1.0 / 65536.0))
        x = rows[NX, k] + reach * math.cos(angle)
        y = rows[NY, k] + reach * math.sin(angle)
        z = rows[NZ, k] + 0.6
        if x * rows[NX, k] + y * rows[NY, k] + z * rows[NZ, k] <= 0.0:
            continue
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z + 1e-9)
        _leave(rows, rays, shadow, k)
        shadow[DX, k], shadow[DY, k], shadow[DZ, k] = x * inverse, y * inverse, z * inverse
        shadow[T, k] = _SKY_RAY_M


@compiled
def _leave(
    rows: NDArray[np.float32], rays: NDArray[np.float32], shadow: NDArray[np.float32], k: int
) -> None:
    """Start a ray a little above the surface that the other one hit."""
    lift = 0.004 + 2e-4 * rays[T, k]
    shadow[OX, k] = rows[PX, k] + lift * rows[NX, k]
    shadow[OY, k] = rows[PY, k] + lift * rows[NY, k]
    shadow[OZ, k] = rows[PZ, k] + lift * rows[NZ, k]


@compiled
def _radiance(
    hits: Hits,
    rays: NDArray[np.float32],
    k: int,
    look: NDArray[np.float32],
    sun: NDArray[np.float32],
    sunlit: bool,
    open_sky: bool,
    pixel_rad: float,
) -> Any:
    """Linear radiance (r, g, b) that comes back along ray `k`."""
    dx, dy, dz = float(rays[DX, k]), float(rays[DY, k]), float(rays[DZ, k])
    surface = hits.surface[k]
    if surface == NOTHING:
        return sky_color(dx, dy, dz, sun)
    rows, material = hits.rows, hits.material[k]
    nx, ny, nz, facing = rows[NX, k], rows[NY, k], rows[NZ, k], float(rows[FACING, k])
    distance = float(rays[T, k])
    footprint = distance * pixel_rad / max(facing, 0.2)
    r, g, b, pane = color_at(
        *(material, look, surface, float(rows[LX, k]), float(rows[LY, k]), float(rows[LZ, k])),
        *(float(rows[U, k]), float(rows[V, k]), footprint),
    )
    toward = nx * sun[0] + ny * sun[1] + nz * sun[2]
    light = max(toward, 0.0) if sunlit else 0.0
    if material == _LEAF:  # lit from behind, leaves shine through
        light = 0.3 + 0.5 * abs(toward) if sunlit else 0.0
    near = 1.0 if open_sky else 0.6
    ambient = (0.62 + 0.38 * nz) * near
    bounce = (0.5 - 0.5 * nz) * near
    r *= _SUN[0] * light + _SKY[0] * ambient + _GROUND[0] * bounce
    g *= _SUN[1] * light + _SKY[1] * ambient + _GROUND[1] * bounce
    b *= _SUN[2] * light + _SKY[2] * ambient + _GROUND[2] * bounce
    gloss = float(MATERIALS[material, 1])
    if pane:
        gloss = 0.55
        curtain = chance(pane, surface, 307)
        if curtain > 0.45:  # a curtain or blind behind the glass
            bright = 0.10 + 0.22 * (curtain - 0.45)
            r, g, b = r + bright, g + 0.97 * bright, b + 0.9 * bright
    if gloss > 0.015:
        mirror = gloss * (0.25 + 0.75 * (1.0 - facing) ** 3)
        if material == _GLASS or pane:
            mirror = 0.12 + 0.75 * (1.0 - facing) ** 2
        mx, my, mz = dx + 2 * facing * nx, dy + 2 * facing * ny, dz + 2 * facing * nz
        sr, sg, sb = sky_color(mx, my, abs(mz), sun)
        if mz < 0.08:  # the mirror shows the street and the houses opposite
            dim = min(1.0, 0.30 + 0.7 * max(0.0, mz / 0.08 + 0.0))
            sr, sg, sb = sr * dim * 0.5, sg * dim * 0.5, sb * dim * 0.45
        if not sunlit:
            sr, sg, sb = min(sr, 1.4), min(sg, 1.4), min(sb, 1.4)
        r, g, b = r + mirror * sr, g + mirror * sg, b + mirror * sb
    haze = 1.0 - math.exp(-distance / 420.0)
    return r + (0.86 - r) * haze, g + (0.92 - g) * haze, b + (1.0 - b) * haze


@compiled
def _through_dust(
    hits: Hits, rays: NDArray[np.float32], k: int, dust: float, r: float, g: float, b: float
) -> Any:
    """The radiance (r, g, b) of ray `k`, dimmed and lit by the dust on its way."""
    distance = float(rays[T, k])
    if hits.surface[k] == NOTHING:
        distance = min(FAR_M, DUST_TOP_M / max(float(rays[DZ, k]), 0.02))
    veil = 1.0 - math.exp(-dust * distance)
    return r + (_DUST[0] - r) * veil, g + (_DUST[1] - g) * veil, b + (_DUST[2] - b) * veil
