"""How a mesh becomes terrain."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.scenes.terrain.solids import DEFAULT_FRICTION, Friction
from nw_eval.words import Collision

# Raise it with every change that changes a solid of any scene: it is part of the cache's key.
COMPILER_VERSION = 5


@dataclass(frozen=True, kw_only=True)
class TerrainOptions:
    """Lengths in metres.

    Attributes:
        collision: `terrain` is height fields and boxes, fast; `triangles` is the mesh's own ones,
            slow and exact, to check the other with.
        spacing: of the samples near the trail. The cost of a step grows with the samples under
            the robot; tests/bench/bench_terrain.py measures it.
        far_spacing: of the samples beyond.
        corridor: what counts as near, to either side of trail and spawn.
        reach: how far beyond trail and spawn there is terrain at all.
        headroom: what hangs higher above the trail than this is passed under.
        reach_down: what lies deeper below the trail than this is not where the robot walks.
        largest_hole: square metres of missing surface that are closed by interpolation.
        least_step: height of an edge that is worth a box of its own.
        friction: of every solid.
    """

    collision: Collision = "terrain"
    spacing: float = 0.0125
    far_spacing: float = 0.05
    corridor: float = 0.8
    reach: float = 5.0
    headroom: float = 1.2
    reach_down: float = 1.0
    largest_hole: float = 0.5
    least_step: float = 0.03
    friction: Friction = DEFAULT_FRICTION
