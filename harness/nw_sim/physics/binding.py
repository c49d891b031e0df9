"""MuJoCo as the type checker sees it.

Its classes live in compiled modules without type information, so that a strict checker finds
nothing in them. Here they are declared as unknown once, instead of at every use.
"""

from typing import Any

import mujoco as _mujoco

mujoco: Any = _mujoco
MjModel = Any
MjData = Any
MjSpec = Any
MjBody = Any  # of a specification
