"""Gaussian splats: files in and out, a compiled store, and renderers for CPU and CUDA.

    image = CpuRenderer(open_store(compiled_store(path))).render(camera)

Files are read and written by `files`, drawn by `render`; `kernels` is the compiled half of the CPU
renderer. Numba is loaded with `render` and not before.
"""

from nw_base.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
