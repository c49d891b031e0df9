"""What tests of students share: their config, and the teacher that is shipped."""

import sys
from pathlib import Path

import pytest

from nw_eval.policies import load_bundle

sys.path.append(str(Path(__file__).parent))  # For `student_parts`.

from student_parts import small_config  # noqa: E402 - found by the line above.


@pytest.fixture
def config():
    return small_config()


@pytest.fixture(scope="session")
def teacher():
    return load_bundle("go1-parkour")
