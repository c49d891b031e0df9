"""Which kind of processor results come from: numerical libraries choose their kernels by it."""

from __future__ import annotations

import os
from hashlib import sha256

from nw_eval.clean import clean

# What else, on one and the same processor, makes a library take other kernels: numba's own
# settings, torch, MKL and oneDNN under it, OpenBLAS and SIMD under NumPy, the C library's sin.
_SETTINGS = (
    "ATEN_CPU_CAPABILITY",
    "DNNL_MAX_CPU_ISA",
    "GLIBC_TUNABLES",
    "MKL_CBWR",
    "MKL_DEBUG_CPU_TYPE",
    "MKL_ENABLE_INSTRUCTIONS",
    "NPY_DISABLE_CPU_FEATURES",
    "NPY_ENABLE_CPU_FEATURES",
    "NUMBA_ENABLE_AVX",
    "NUMBA_OPT",
    "ONEDNN_MAX_CPU_ISA",
    "OPENBLAS_CORETYPE",
)


def cpu_kind() -> str:
    """Return a short text that is equal where the kernels are, such as `znver4 1f0c77a2`.

    The name is LLVM's, or what `NUMBA_CPU_NAME` says; the digits are a digest of the instruction
    sets, or of `NUMBA_CPU_FEATURES`. Settings by which libraries choose other kernels follow.
    """
    from llvmlite import binding

    name = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    flags = os.environ.get("NUMBA_CPU_FEATURES")
    if flags is None:
        try:
            flags = binding.get_host_cpu_features().flatten()
        except RuntimeError:  # LLVM cannot tell on this platform; numba then uses none.
            flags = ""
    listed = ",".join(sorted(flag.strip() for flag in flags.split(",")))
    words = [name, sha256(listed.encode()).hexdigest()[:8]]
    words += [f"{key}={value}" for key in _SETTINGS if (value := os.environ.get(key))]
    return clean(" ".join(words), at_most=200)
