"""The thermal camera: what every surface radiates, in hundredths of a kelvin."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.kernels.compiled import compiled
from stages.simulation.camera import DUST_TOP_M, FAR_M, aim_at_sun, aim_through_pixels
from stages.simulation.hits import FACING, LX, LY, LZ, NX, NY, NZ, Hits, U, V, resolve
from stages.simulation.materials import MATERIALS, Material
from stages.simulation.noise import chance, fractal_noise
from stages.simulation.textures import PANE, facade_part, is_facade
from stages.simulation.trace import DZ, NOTHING, PACKET, TILE, Packet, Scene, T, trace

AIR_C = 14.0
_ZERO_C = 27315.0  #: counts at 0 degC, of 0.01 K
_STEP = 4  #: counts: the camera resolves 0.04 K
_BLUR_PX = 0.6  #: the lens, and what a microbolometer's pixels share
_HOOD, _ZEBRA = int(Material.HOOD), int(Material.ZEBRA)


def thermal_image(
    scene: Scene,
    world_from_camera: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    size: tuple[int, int],
    sun: NDArray[np.float32],
    seed: int,
    frame: int,
    netd_k: float,
    dust: float,
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Counts (h, w) of 0.01 K and the things (h, w) behind them.

    `netd_k` is the noise of a pixel, K; a fixed pattern of columns and pixels, from the `seed`
    alone, is half as strong. `dust` is the extinction of the air, per m.
    """
    width, height = size
    celsius = np.empty((height, width), dtype=np.float32)
    things = np.empty((height, width), dtype=np.uint16)
    # A warm street forgets the shadow of a passer-by at once: only what stands still throws one.
    still = scene._replace(roots=scene.roots[:0])
    _radiate(
        scene,
        still,
        Packet.new(),
        Packet.new(),
        Hits.new(),
        world_from_camera,
        intrinsics,
        sun,
        dust,
        celsius,
        things,
    )
    blurred = cv2.GaussianBlur(celsius, (0, 0), _BLUR_PX)
    fixed = np.random.default_rng([seed, 0xF1])
    pattern = fixed.standard_normal((height, width), dtype=np.float32)
    pattern += 1.2 * fixed.standard_normal((1, width), dtype=np.float32)
    random = np.random.default_rng([seed, 0xF2, frame])
    noise = random.standard_normal((height, width), dtype=np.float32) + 0.5 * pattern
    counts = _ZERO_C + 100.0 * (blurred + np.float32(netd_k) * noise)
    stepped = np.round(counts / _STEP) * _STEP
    return np.clip(stepped, 0, 65535).astype(np.uint16), things


@compiled
def _radiate(
    scene: Scene,
    still: Scene,
    packet: Packet,
    shadow: Packet,
    hits: Hits,
    world_from_camera: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    sun: NDArray[np.float32],
    dust: float,
    celsius: NDArray[np.float32],
    things: NDArray[np.uint16],
) -> None:
    """Apparent temperature (h, w), degC, and things (h, w)."""
    height, width = celsius.shape
    fx = intrinsics[0]
    rays = packet.rays
    for top in range(0, height, TILE[0]):
        for left in range(0, width, TILE[1]):
            aim_through_pixels(rays, top, left, world_from_camera, intrinsics)
            trace(scene, packet, False)
            resolve(scene, packet, hits)
            aim_at_sun(hits, rays, shadow.rays, sun)
            trace(still, shadow, True)
            for k in range(PACKET):
                row, column = top + k // TILE[1], left + k % TILE[1]
                if row >= height or column >= width:
                    continue
                lit = shadow.triangle[k] == NOTHING
                seen = _temperature(hits, rays, k, scene.look, sun, lit, 1.0 / fx)
                distance = float(rays[T, k])
                if hits.surface[k] == NOTHING:
                    distance = min(FAR_M, DUST_TOP_M / max(float(rays[DZ, k]), 0.02))
                # Dust is as warm as the air that carries it.
                celsius[row, column] = seen + (AIR_C - seen) * (1.0 - math.exp(-dust * distance))
                things[row, column] = hits.thing[k]


@compiled
def _sky_c(up: float) -> Any:
    """The sky's apparent temperature: cold overhead, near the air's at the horizon."""
    return -3.0 - 24.0 * math.sqrt(max(up, 0.0))


@compiled
def _temperature(
    hits: Hits,
    rays: NDArray[np.float32],
    k: int,
    look: NDArray[np.float32],
    sun: NDArray[np.float32],
    lit: bool,
    pixel_rad: float,
) -> Any:
    """Apparent temperature of what ray `k` meets, degC."""
    dz = float(rays[DZ, k])
    surface = hits.surface[k]
    if surface == NOTHING:
        return _sky_c(dz)
    rows, material = hits.rows, hits.material[k]
    nx, ny, nz, facing = rows[NX, k], rows[NY, k], rows[NZ, k], float(rows[FACING, k])
    x, y, z = float(rows[LX, k]), float(rows[LY, k]), float(rows[LZ, k])
    u, v = float(rows[U, k]), float(rows[V, k])
    celsius = AIR_C + float(MATERIALS[material, 2])
    footprint = float(rays[T, k]) * pixel_rad / max(facing, 0.2)
    # Dark paint warms more than light paint.
    bright = float(look[surface, 0] + look[surface, 1] + look[surface, 2]) / 3.0
    gain = float(MATERIALS[material, 3]) * (1.25 - 0.8 * min(bright, 1.0))
    toward = nx * sun[0] + ny * sun[1] + nz * sun[2]
    if lit:
        celsius += gain * (0.25 + 0.75 * max(toward, 0.0))
    celsius += 1.6 * (fractal_noise(x * 0.8, y * 0.8 + z, footprint * 0.8, 4, 401) - 0.5)
    mirror = 0.04 + 0.5 * float(MATERIALS[material, 1]) * (1.0 - facing)
    if material == _ZEBRA and v - math.floor(v) < 0.5:
        celsius -= 0.9  # white paint
    if material == _HOOD:
        celsius += 8.0 * math.exp(-2.0 * (x - 1.4) * (x - 1.4))  # over the engine block
    if is_facade(material):
        width, height, seed = look[surface, 3], look[surface, 4], look[surface, 5]
        part, window = facade_part(u, v, width, height, seed)
        if part == PANE:  # single panes leak warmth, coated ones mirror the sky
            celsius = AIR_C - 3.0 + 7.0 * chance(window, surface, 409)
            mirror = 0.25
        elif height >= 1.0:
            # Floor slabs and lintels conduct.
            storey = (v - 0.5) / 2.9
            celsius += 0.7 * math.exp(-60.0 * (storey - math.floor(storey + 0.5)) ** 2)
    mirrored_z = dz + 2.0 * facing * nz
    reflected = _sky_c(mirrored_z) if mirrored_z > 0.05 else AIR_C + 2.0
    celsius += mirror * (reflected - celsius)
    haze = 1.0 - math.exp(-float(rays[T, k]) / 700.0)
    return celsius + (AIR_C - celsius) * haze
