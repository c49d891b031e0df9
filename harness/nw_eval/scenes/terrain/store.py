"""Compiled terrain in the user's cache, by content."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.files.cache import cache_dir, read_sealed, sealed_path
from nw_eval.scenes.digest import digest
from nw_eval.scenes.health.finding import SceneFinding
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Box
from nw_eval.scenes.terrain.compile import Accuracy, Terrain, build_terrain
from nw_eval.scenes.terrain.options import COMPILER_VERSION, TerrainOptions
from nw_eval.scenes.terrain.solids import HeightField, Triangles

_META = "meta"


def terrain_key(
    mesh: TriangleMesh,
    *,
    trail: NDArray[np.float64],
    spawn: NDArray[np.float64],
    options: TerrainOptions,
) -> str:
    """Return the hex digest of everything that terrain is compiled from."""
    return digest(COMPILER_VERSION, mesh.vertices, mesh.faces, trail, spawn, options)


def compiled_terrain(
    mesh: TriangleMesh,
    *,
    trail: NDArray[np.float64],
    spawn: NDArray[np.float64],
    options: TerrainOptions | None = None,
    rays: RayScene | None = None,
) -> Terrain:
    """Return the terrain of a mesh from the cache; compile it on first use.

    Arguments as `build_terrain`. A damaged file in the cache is written again.

    Raises:
        StoreError: the cache cannot be written.
    """
    chosen = TerrainOptions() if options is None else options
    key = terrain_key(mesh, trail=trail, spawn=spawn, options=chosen)
    path = cache_dir("scenes", "terrain") / f"{key[:32]}.npz"
    kept = _read(path, key, mesh, chosen)
    if kept is not None:
        return kept
    terrain = build_terrain(mesh, trail=trail, spawn=spawn, options=chosen, rays=rays)
    _write(path, key, terrain)
    return terrain


def _write(path: Path, key: str, terrain: Terrain) -> None:
    fields = [solid for solid in terrain.solids if isinstance(solid, HeightField)]
    meta = {
        "key": key,
        "floor": terrain.floor,
        "spawn_height": terrain.spawn_height,
        "accuracy": asdict(terrain.accuracy),
        "findings": [asdict(finding) for finding in terrain.findings],
        "boxes": [asdict(solid) for solid in terrain.solids if isinstance(solid, Box)],
        "fields": [
            {
                "center": field.center,
                "half_size": field.half_size,
                "floor": field.floor,
                "friction": field.friction,
            }
            for field in fields
        ],
    }
    arrays: dict[str, Any] = {f"heights_{i}": field.heights for i, field in enumerate(fields)}
    text = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    with sealed_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{_META: text}, **arrays)


def _read(path: Path, key: str, mesh: TriangleMesh, options: TerrainOptions) -> Terrain | None:
    """Return what a file holds; None if it is missing, damaged, or of another content."""
    try:
        with np.load(io.BytesIO(read_sealed(path)), allow_pickle=False) as data:
            meta = json.loads(bytes(data[_META]))
            if meta["key"] != key:
                return None
            fields = [
                HeightField(heights=data[f"heights_{index}"], **_tuples(field))
                for index, field in enumerate(meta["fields"])
            ]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None
    solids: tuple[HeightField | Box | Triangles, ...] = (
        *fields,
        *(Box(**_tuples(box)) for box in meta["boxes"]),
    )
    if options.collision == "triangles":
        own = Triangles(vertices=mesh.vertices, faces=mesh.faces, friction=options.friction)
        solids = (own,)
    return Terrain(
        solids=solids,
        floor=meta["floor"],
        spawn_height=meta["spawn_height"],
        accuracy=Accuracy(**meta["accuracy"]),
        findings=tuple(SceneFinding(**_tuples(finding)) for finding in meta["findings"]),
    )


def _tuples(record: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(part) if isinstance(part, list) else part for name, part in record.items()}
