"""Makes the helpers of this folder importable, and a small cache folder for the session."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """A fresh user cache, for tests that look into it."""
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
