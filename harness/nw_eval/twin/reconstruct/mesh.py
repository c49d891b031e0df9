"""Coloured triangle meshes, and `mesh.ply`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.files.cache import atomic_path
from nw_eval.files.ply import Ply
from nw_eval.scenes.mesh_file import read_mesh
from nw_eval.twin.packages import package


@dataclass(frozen=True, kw_only=True, eq=False)
class ColourMesh:
    """Triangles in a capture's frame and unit, counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int32 numbers of vertices.
        colours: (V, 3) uint8.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colours: NDArray[np.uint8]

    @property
    def normals(self) -> NDArray[np.float64]:
        """Of each face, as long as twice its area, (F, 3)."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def keep(self, faces: NDArray[np.bool_]) -> ColourMesh:
        """Return the mesh of some of the faces, without vertices that none uses."""
        used, renumbered = np.unique(self.faces[faces], return_inverse=True)
        return ColourMesh(
            vertices=self.vertices[used],
            faces=renumbered.reshape(-1, 3).astype(np.int32),
            colours=self.colours[used],
        )


def parts_of(links: NDArray[np.integer], count: int) -> tuple[int, NDArray[np.int32]]:
    """Return how many parts `count` vertices are in, and the part of each.

    Args:
        links: (N, K), K >= 2: vertices in a row belong together.
        count: of vertices.
    """
    sparse, graph = package("scipy.sparse"), package("scipy.sparse.csgraph")
    one = np.repeat(links[:, 0], links.shape[1] - 1)
    other = links[:, 1:].ravel()
    ones = np.ones(len(one), np.int8)
    matrix = sparse.coo_array((ones, (one, other)), shape=(count, count))
    return graph.connected_components(matrix, directed=False)


def write_mesh(mesh: ColourMesh, path: Path) -> None:
    """Write a mesh as a binary PLY with colours of its vertices.

    Raises:
        StoreError: the file cannot be written.
    """
    from trimesh import Trimesh
    from trimesh.exchange.ply import export_ply

    shape = Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colours, process=False)
    with atomic_path(path) as temporary:
        temporary.write_bytes(export_ply(shape, encoding="binary", vertex_normal=False))


def read_colour_mesh(path: Path) -> ColourMesh:
    """Read a mesh; one without colours is grey.

    Raises:
        SceneError: as `nw_eval.scenes.mesh_file.read_mesh`.
    """
    mesh = read_mesh(path)  # Everything is checked there; colours are all that is left to read.
    colours = np.full((len(mesh.vertices), 3), 128, np.uint8)
    table = Ply.open(path).elements["vertex"]
    if {"red", "green", "blue"} <= set(table.dtype.names or ()):
        colours = np.stack([table[name] for name in ("red", "green", "blue")], axis=-1)
        if colours.dtype.kind == "f":  # Shares of 1.
            colours = np.clip(np.nan_to_num(colours) * 255, 0, 255).round()
        colours = colours.astype(np.uint8)
    return ColourMesh(vertices=mesh.vertices, faces=mesh.faces, colours=colours)
