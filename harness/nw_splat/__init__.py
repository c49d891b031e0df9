"""Gaussian splats: files in and out, a compiled store, and renderers for CPU and CUDA.

    image = CpuRenderer(open_store(compiled_store(path))).render(camera)

Bottom layer: imports nothing of nw_eval but errors, words and the cache. Files are read and written
by `files`, drawn by `render`; `kernels` is the compiled half of the CPU renderer. Numba is loaded
with `render` and not before.
"""
