"""Paint for cells: asks each material once for all the cells it covers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nw_eval.built_in.bake.surfels import Cells, Frames, position
from nw_eval.built_in.paint.noise import Array
from nw_eval.built_in.paint.registry import coat
from nw_eval.built_in.paint.spots import Spots
from nw_eval.built_in.places.parts import Light, Patch


def paint(
    patches: Sequence[Patch], geometry: Frames, cells: Cells, light: Light
) -> tuple[Array, Array]:
    """Return albedo and glow of cells, both (N, 3), linear."""
    albedo = np.zeros((len(cells), 3))
    glow = np.zeros((len(cells), 3))
    names: dict[str, int] = {}
    most = max((len(patch.decals) for patch in patches), default=0)
    # For each patch and decal (the last column: none): material, corner, size, texture.
    material = np.zeros((len(patches), most + 1), dtype=np.int64)
    box = np.zeros((len(patches), most + 1, 6))
    for index, patch in enumerate(patches):
        material[index, -1] = names.setdefault(patch.material, len(names))
        box[index, -1] = (
            0.0, 0.0, geometry.width[index], geometry.height[index], *patch.texture
        )  # fmt: skip
        for number, decal in enumerate(patch.decals):
            u0, v0, u1, v1 = decal.rect
            material[index, number] = names.setdefault(decal.material, len(names))
            box[index, number] = (u0, v0, u1 - u0, v1 - v0, 0.0, 0.0)
    points = position(cells, geometry)
    of = material[cells.patch, cells.decal]
    for name, number in names.items():
        mine = np.flatnonzero(of == number)
        if len(mine) == 0:
            continue
        at = cells.patch[mine]
        frame = box[at, cells.decal[mine]]
        s, t = cells.s[mine] - frame[:, 0], cells.t[mine] - frame[:, 1]
        result = coat(
            name,
            Spots(
                p=points[mine],
                n=geometry.normal[at],
                u=s + frame[:, 4],
                v=t + frame[:, 5],
                s=s,
                t=t,
                w=frame[:, 2],
                h=frame[:, 3],
                blur=np.sqrt(cells.width[mine] * cells.height[mine]),
                seed=((at + 1) * 7919 + (cells.decal[mine] + 1) * 104729).astype(np.uint32),
                light=light,
            ),
        )
        albedo[mine] = np.clip(result.albedo, 0.004, 0.92)
        if result.glow is not None:
            glow[mine] = np.maximum(result.glow, 0.0)
    return albedo, glow
