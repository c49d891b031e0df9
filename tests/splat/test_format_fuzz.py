"""Mutated files: an error of ours or Gaussians, never a crash, never much memory.

NW_EVAL_FUZZ sets the number of mutated files (600 otherwise); 12,000 take a few minutes.
"""

import contextlib
import gzip
import os
import resource
import warnings

import numpy as np
import pytest
import torch
from splat_rooms import cloud
from test_formats import FIXTURES, _checkpoint

from nw_eval.errors import NwEvalError, PrerequisiteError
from nw_eval.splat import (
    compile_store,
    describe,
    memory_store,
    open_store,
    read_splat,
    write_splat,
)
from nw_eval.splat.files.spz import write_spz

FILES = int(os.environ.get("NW_EVAL_FUZZ", "600"))
_NUMBERS = (b"\0", b"\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"999999999", b"-1", b"NaN")


def _seeds(folder):
    write_splat(folder / "a.ply", cloud(30))
    write_splat(folder / "a.splat", cloud(30))
    write_spz(folder / "two.spz", cloud(30), version=2)
    write_spz(folder / "three.spz", cloud(30), version=3)
    with contextlib.suppress(PrerequisiteError):
        write_spz(folder / "four.spz", cloud(30), version=4)
    torch.save({"splats": _checkpoint(cloud(30))}, folder / "a.pt")
    (folder / "b.ply").write_bytes((FIXTURES / "cloud.compressed.ply").read_bytes())
    compile_store(cloud(30), folder / "a.nwsplat")
    return sorted(folder.iterdir())


def _mutate(data, rng):
    """Flip bytes, cut, repeat, insert numbers; the front of a file gets most of it."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        span = len(data) if rng.random() < 0.4 else min(len(data), 1200)
        if span == 0:
            break
        place = int(rng.integers(span))
        match int(rng.integers(5)):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place] = int(rng.integers(256))
            case 2:
                end = len(data) if rng.random() < 0.3 else place + 9
                del data[place:end]
            case 3:
                number = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
                data[place : place + len(number)] = number
            case _:
                data[place:place] = data[place : place + int(rng.integers(1, 64))]
    return bytes(data)


def _mutate_inside(path, data, rng):
    """Mutate what a compressed stream holds, so that the fuzz gets past the checksum."""
    if path.suffix == ".spz" and data[:2] == b"\x1f\x8b" and rng.random() < 0.5:
        return gzip.compress(_mutate(gzip.decompress(data), rng), 1)
    return _mutate(data, rng)


def _use(path):
    """Read a file as a renderer would, down to the arrays of the kernels."""
    if path.suffix == ".nwsplat":
        open_store(path)
        return
    gaussians = read_splat(path)
    assert describe(gaussians).count == len(gaussians)
    memory_store(gaussians)


@pytest.mark.timeout(3600)
def test_mutated_files_raise_our_errors_or_give_gaussians(tmp_path):
    (tmp_path / "seeds").mkdir()
    seeds = [(path, path.read_bytes()) for path in _seeds(tmp_path / "seeds")]
    rng = np.random.default_rng(20261)
    refused = read = lines = 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for i in range(FILES):
        source, data = seeds[i % len(seeds)]
        path = tmp_path / f"mutated{source.suffix}"
        path.write_bytes(_mutate_inside(source, data, rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                _use(path)
            read += 1
        except NwEvalError as error:
            refused += 1
            lines = str(error).count("\n")
        except Exception as error:
            kept = tmp_path / f"failed-{i}{source.suffix}"
            path.rename(kept)
            raise AssertionError(f"{source.name}, file {i} ({kept}): {error!r}") from error
        assert lines == 0
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    # Shown with -s: the figures of a long run.
    print(f"{FILES} mutated files: {refused} refused, {read} read, {grown:.0f} MB more at peak")  # noqa: T201
    assert refused > FILES / 10
    assert read > FILES / 10
    assert grown < 400
