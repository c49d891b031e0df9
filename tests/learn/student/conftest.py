"""What tests of students share: their config, and the teacher that is shipped."""

import sys
from pathlib import Path

import pytest

from nw_policies import load_bundle

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def config():
    from student_parts import small_config

    return small_config()


@pytest.fixture(scope="session")
def teacher():
    return load_bundle("go1-parkour")
