"""Points as `scene.yaml` spells them, and a collision mesh as its file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.files.cache import atomic_path


def rounded(point: Iterable[float]) -> list[float]:
    """Return metres, to a tenth of a millimetre."""
    return [round(float(part), 4) for part in point]


def write_collision(
    path: Path, vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]
) -> None:
    """Write vertices (V, 3), world, m, and faces (F, 3) as a PLY file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    with atomic_path(path) as temporary:
        mesh.export(temporary, file_type="ply")
