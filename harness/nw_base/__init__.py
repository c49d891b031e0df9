"""What all packages of nw-eval stand on: errors, words, files, the fence, compiled vectors.

Nothing here knows robots, scenes or policies. It needs NumPy; modules that read YAML or compile
kernels import ruamel.yaml, pydantic or numba themselves.
"""

from __future__ import annotations

__version__ = "0.2.0"
"""Of all packages together."""
