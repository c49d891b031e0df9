"""What one can do with nw-eval. The command line and other doors call these and nothing deeper.

Its public names are stated in `__init__.pyi`, and are imported when they are first used.
"""

from __future__ import annotations

import importlib
import os
import sys

from nw_base.public import public_names


def _see_to_mujoco() -> None:
    """Import MuJoCo without OpenGL, of which nothing here has need, where it cannot be with it."""
    name = os.environ.get("MUJOCO_GL", "disable")
    if name == "disable" or "mujoco" in sys.modules:
        return
    try:
        importlib.import_module("mujoco")
    except Exception:  # noqa: BLE001 - of PyOpenGL, where a library of the system is missing.
        os.environ["MUJOCO_GL"] = "disable"
        importlib.import_module("mujoco")
        os.environ["MUJOCO_GL"] = name


_see_to_mujoco()

__getattr__, __dir__, __all__ = public_names(  # pyright: ignore[reportUnsupportedDunderAll]
    __name__, __file__
)
