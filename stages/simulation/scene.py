"""From meshes to the arrays that rays are traced through, and the scene at an instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.simulation.bvh import build
from stages.simulation.mesh import Mesh
from stages.simulation.trace import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Everything that can be seen, before its moving parts are put in their places."""

    scene: Scene  #: its parts stand at the origin
    part_lows: NDArray[np.float32]  #: (parts, 3) box of each part in its own frame
    part_highs: NDArray[np.float32]

    @classmethod
    def of(cls, still: Mesh, parts: Sequence[Mesh]) -> Model:
        """Build the hierarchies of what stands still and of each rigid part."""
        boxes, children, triangles, normals, uv, surface = [], [], [], [], [], []
        roots, lows, highs = [], [], []
        node = first = surfaces = 0
        for mesh in (still, *parts):
            corners = np.concatenate(mesh.corners).astype(np.float32)
            low, high = corners.min(axis=1), corners.max(axis=1)
            tree = build(low, high)
            boxes.append(tree.boxes)
            # A node moves by the nodes before it, a leaf's first triangle by the triangles before.
            children.append(
                np.where(tree.children >= 0, tree.children + node, tree.children - 8 * first)
            )
            a, b, c = (corners[tree.order, k] for k in range(3))
            triangles.append(np.concatenate([a, b - a, c - a], axis=1))
            normals.append(np.concatenate(mesh.normals)[tree.order].reshape(-1, 9))
            uv.append(np.concatenate(mesh.uv)[tree.order].reshape(-1, 6))
            surface.append(np.concatenate(mesh.surface_of)[tree.order] + surfaces)
            roots.append(node)
            lows.append(low.min(axis=0))
            highs.append(high.max(axis=0))
            node += len(tree.boxes)
            first += len(corners)
            surfaces += len(mesh.surfaces)
        all_surfaces = [entry for mesh in (still, *parts) for entry in mesh.surfaces]
        things = [thing for mesh in (still, *parts) for thing in mesh.things]
        look = [(*entry.color, *entry.size, entry.seed) for entry in all_surfaces]
        empty = np.zeros((0, 3), dtype=np.float32)
        scene = Scene(
            np.concatenate(boxes),
            np.concatenate(children).astype(np.int32),
            np.concatenate(triangles),
            np.concatenate(normals).astype(np.float32),
            np.concatenate(uv).astype(np.float32),
            np.concatenate(surface).astype(np.int32),
            np.array([entry.material for entry in all_surfaces], dtype=np.int32),
            np.array(things, dtype=np.int32),
            np.array(look, dtype=np.float32),
            np.array(roots[1:], dtype=np.int32),
            np.zeros((len(parts), 3, 4), dtype=np.float32),
            *build(np.zeros((1, 3), dtype=np.float32), np.zeros((1, 3), dtype=np.float32)),
        )
        return cls(
            scene, np.array(lows[1:]) if parts else empty, np.array(highs[1:]) if parts else empty
        )

    def at(self, world_from_part: NDArray[np.float64]) -> Scene:
        """The scene with its moving parts at the poses (parts, 4, 4)."""
        if len(world_from_part) == 0:
            return self.scene
        rotation, offset = world_from_part[:, :3, :3], world_from_part[:, :3, 3]
        center = (self.part_lows + self.part_highs) / 2
        half = (self.part_highs - self.part_lows) / 2
        middle = (rotation @ center[..., None])[..., 0] + offset
        reach = (np.abs(rotation) @ half[..., None])[..., 0]
        tree = build((middle - reach).astype(np.float32), (middle + reach).astype(np.float32))
        return self.scene._replace(
            world_from_part=world_from_part[:, :3].astype(np.float32),
            part_boxes=tree.boxes,
            part_children=tree.children,
            part_order=tree.order,
        )
