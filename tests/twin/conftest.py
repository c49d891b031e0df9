"""Makes the helpers of this folder and of the renderer's tests importable, and runs commands."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "splat"))

from nw_eval import cli


@pytest.fixture
def ended(capsys):
    """Run `nw-eval` with some words; return its exit code and what it printed."""

    def run(*words):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in words])
        return left.value.code or 0, capsys.readouterr()

    return run
