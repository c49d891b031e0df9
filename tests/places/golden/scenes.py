"""What the built-in scenes were when their generator's version was last raised.

`python tests/places/golden/scenes.py` writes the record anew. It refuses while the code that
makes Gaussians differs from the record's and the version does not: raise `GENERATOR_VERSION` first.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import nw_places
from nw_places.entry import GENERATOR_VERSION
from nw_scenes.digest import digest
from nw_sim.catalogue import get_scene, names

RECORD = Path(__file__).with_name("scenes.json")

# A place and this code determine its Gaussians.
_GENERATOR = ("bake/*.py", "places/crowns.py")


def source() -> str:
    """Return the hex digest of the code that turns places into Gaussians."""
    root = Path(nw_places.__file__).parent
    files = (file for pattern in _GENERATOR for file in root.glob(pattern))
    return _digest_of_code(file.read_text() for file in files)


def _digest_of_code(texts: Iterable[str]) -> str:
    """Return the hex digest of the definitions in sources.

    Comments, docstrings, layout and imports do not count; so it is the same under every version of
    Python. Nor does the file in which a definition stands, or its place there.
    """
    statements = [node for text in texts for node in ast.parse(text).body if not _is_text(node)]
    shapes = {repr(_shape(node)) for node in statements if not isinstance(node, ast.ImportFrom)}
    return hashlib.sha256("\n".join(sorted(shapes)).encode()).hexdigest()


def geometry(name: str) -> str:
    """Return the hex digest of what physics and rays meet, and of the trail, to a micrometre."""
    scene = get_scene(name)
    mesh = scene.mesh()
    boxes = [[*box.center, *box.half_size, *box.quat, *box.friction] for box in scene.solids]
    numbers = [np.array(boxes), mesh.vertices, scene.trail, np.array(scene.spawn.position)]
    # Adding 0 turns -0 into 0.
    rounded = [np.round(array, 6) + 0.0 for array in numbers]
    kinds = [box.kind for box in scene.solids]
    return digest(rounded, kinds, mesh.faces, mesh.kinds, scene.ground.z, scene.waypoint_noise)[:24]


def record() -> dict[str, object]:
    """Return the record of the code and the scenes as they are."""
    return {
        "version": GENERATOR_VERSION,
        "source": source(),
        "geometry": {name: geometry(name) for name in names()},
    }


def _shape(node: object) -> object:
    """Return a syntax tree as nested tuples, without docstrings and positions."""
    if isinstance(node, list):
        # Where a name is kept makes no Gaussian.
        return tuple(_shape(item) for item in node if not isinstance(item, ast.ImportFrom))
    if not isinstance(node, ast.AST):
        return repr(node)
    found: list[object] = [type(node).__name__]
    for field, value in ast.iter_fields(node):
        kept = value
        if field == "body" and isinstance(value, list) and value and _is_text(value[0]):
            kept = value[1:]
        # Python versions differ in which empty fields they know.
        if kept is not None and kept != [] and field != "kind":
            found.append((field, _shape(kept)))
    return tuple(found)


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


if __name__ == "__main__":
    new, old = record(), json.loads(RECORD.read_text()) if RECORD.exists() else {}
    if old and old["source"] != new["source"] and old["version"] == new["version"]:
        sys.exit(
            "the generator's code has changed: raise GENERATOR_VERSION in built_in/entry.py first"
        )
    RECORD.write_text(json.dumps(new, indent=1) + "\n")
