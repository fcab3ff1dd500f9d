"""Solids are closed where they should be, and face outward."""

from __future__ import annotations

import numpy as np
import pytest

from stages.simulation.bicycles import bicycle
from stages.simulation.materials import Material
from stages.simulation.mesh import Mesh, Surface, standing
from stages.simulation.vehicles import KINDS, car

GRAY = Surface(Material.PLAIN)


def volume(mesh: Mesh) -> float:
    """By the divergence theorem: right only for a closed surface that faces outward."""
    a, b, c = np.moveaxis(np.concatenate(mesh.corners), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_a_box_encloses_its_volume() -> None:
    mesh = Mesh()
    mesh.box(1, GRAY, (3.0, -2.0, 1.0), (2.0, 3.0, 0.5), yaw=0.4, bottom=True)
    assert volume(mesh) == pytest.approx(3.0)


def test_an_ellipsoid_encloses_nearly_its_volume() -> None:
    mesh = Mesh()
    mesh.ellipsoid(1, GRAY, (1.0, 1.0, 1.0), (1.0, 2.0, 0.5), sides=48, stacks=33)
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.02)


def test_a_tube_encloses_nearly_its_volume() -> None:
    mesh = Mesh()
    mesh.tube(1, GRAY, [(0, 0, 0), (1, 1, 1), (2, 2, 2)], 0.1, sides=48)
    assert volume(mesh) == pytest.approx(np.pi * 0.01 * np.sqrt(12), rel=0.01)


def test_normals_have_unit_length_and_point_away_from_the_middle() -> None:
    mesh = Mesh()
    mesh.ellipsoid(1, GRAY, (0, 0, 0), (1.0, 2.0, 0.5))
    corners, normals = np.concatenate(mesh.corners), np.concatenate(mesh.normals)
    assert np.linalg.norm(normals, axis=-1) == pytest.approx(1.0)
    assert (np.einsum("ijk,ijk->ij", corners, normals) > 0).all()


def test_an_inserted_mesh_is_moved_with_its_normals() -> None:
    part, whole = Mesh(), Mesh()
    part.box(4, GRAY, (0, 0, 0.5), (1, 1, 1), bottom=True)
    whole.quad(3, GRAY, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    whole.insert(part, standing(10.0, 5.0, np.pi / 2))
    corners = np.concatenate(whole.corners[1:])
    assert corners.reshape(-1, 3).mean(axis=0)[:2] == pytest.approx((10.0, 5.0))
    assert np.concatenate(whole.surface_of).max() == 1
    assert whole.things == [3, 4]


@pytest.mark.parametrize("kind", KINDS)
def test_a_car_has_the_size_of_a_car_and_stands_on_the_ground(kind: str) -> None:
    corners = np.concatenate(car(1, kind, (0.5, 0.5, 0.5), 0.0).corners).reshape(-1, 3)
    length, width, height = np.ptp(corners, axis=0)
    assert 3.8 < length < 5.2
    assert 1.7 < width < 2.3  # with the mirrors
    assert 1.4 < height < 2.1
    assert corners[:, 2].min() == pytest.approx(0.0, abs=0.02)


def test_a_bicycle_has_the_size_of_a_bicycle() -> None:
    corners = np.concatenate(bicycle(1, (0.1, 0.1, 0.1)).corners).reshape(-1, 3)
    assert np.ptp(corners, axis=0) == pytest.approx((1.78, 0.62, 1.1), abs=0.1)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=0.02)
