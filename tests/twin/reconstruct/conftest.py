"""Makes the room importable, and reconstructs it once for all tests that look at the result."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from small_room import SMALL, write_room

from nw_twin.reconstruct.reconstruct import reconstruct


@pytest.fixture(scope="session")
def room(tmp_path_factory):
    """The folder of a capture of ten small pictures."""
    folder = tmp_path_factory.mktemp("room") / "capture"
    write_room(folder)
    return folder


@pytest.fixture(scope="session")
def built(room):
    """The folder of its mesh, the report, and what was said."""
    words = []
    out = room.parent / "mesh"
    report = reconstruct(room, out, SMALL, words.append, threads=2)
    return out, report, words
