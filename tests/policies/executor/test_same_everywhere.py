"""Networks give the same bits whatever instructions their machine code is compiled for."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

DIGESTS = """
import hashlib
import numpy as np
from pathlib import Path
from nw_policies.executor.network import Network
from nw_policies.executor.plan import plan
from nw_policies.networks.onnx_reading import read_graph

for path in sorted(Path("policies").glob("*/*.onnx")):
    network = Network(plan(read_graph(path.read_bytes())))
    rng, digest = np.random.default_rng(5), hashlib.sha256()
    for _ in range(10):
        feeds = {
            name: rng.integers(0, 256, array.shape) if array.size > 10_000
            else rng.standard_normal(array.shape)
            for name, array in network.inputs.items()
        }
        for array in network(feeds).values():
            digest.update(array.tobytes())
    print(path, digest.hexdigest())
"""
MASKS = {
    "AVX2 and FMA": {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c"},
    "AVX-512 off in libraries": {
        "NPY_DISABLE_CPU_FEATURES": "X86_V4",
        "OPENBLAS_CORETYPE": "Haswell",
        "NUMBA_CPU_NAME": "znver3",
        "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c,+bmi,+bmi2",
    },
    "SSE4 without FMA": {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": "+sse4.2"},
}


def digests(project, mask):
    """Return what the networks of the shipped policies give, in a process with other features."""
    done = subprocess.run(
        [sys.executable, "-c", DIGESTS],
        cwd=project,
        env={**os.environ, **mask},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


@pytest.fixture
def project(request):
    """Return the folder of the shipped policies."""
    return request.config.rootpath


def test_shipped_networks_give_the_same_bits_without_avx_512(project):
    native = digests(project, {})
    assert len(native) >= 7
    assert digests(project, MASKS["AVX2 and FMA"]) == native


@pytest.mark.nightly
@pytest.mark.parametrize("mask", ["AVX-512 off in libraries", "SSE4 without FMA"])
def test_shipped_networks_give_the_same_bits_on_other_processors(project, mask):
    assert digests(project, MASKS[mask]) == digests(project, {})
