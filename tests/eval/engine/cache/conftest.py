import sys
from pathlib import Path

import pytest

from nw_eval.engine.cache import TrialStore
from nw_gate.results.run_folder import RunFolder

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def folder(tmp_path):
    return RunFolder(path=tmp_path / "run")


@pytest.fixture
def store(tmp_path):
    return TrialStore(tmp_path / "trials")
