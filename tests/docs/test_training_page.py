"""docs/how-to/training.md says what the configs of teachers have, and what they have by default."""

import re
from pathlib import Path

import pytest

from nw_learn.teacher.config import (
    CourseSettings,
    PpoSettings,
    TeacherConfig,
    TrainingPhase,
)

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "training.md").read_text(encoding="utf-8")
ROWS = {
    key: (meaning, default)
    for key, meaning, default in re.findall(
        r"^\| `(\w+)` \| (.+) \| ?(.*?) ?\|$", PAGE, re.MULTILINE
    )
}


def test_the_page_has_every_key_and_no_other():
    assert ROWS.keys() == TeacherConfig.model_fields.keys() - {"version"}


@pytest.mark.parametrize("key", ["keep_every", "device", "threads", "overlap", "start"])
def test_defaults_are_those_of_the_code(key):
    default = TeacherConfig.model_fields[key].get_default()
    assert ROWS[key][1].strip("`") == str(default).lower().removesuffix(".0")


def test_settings_of_ppo_come_with_their_defaults_in_order():
    meaning, default = ROWS["ppo"]
    names = re.findall(r"`(\w+)`", meaning)
    assert names == list(PpoSettings.model_fields)
    found = [PpoSettings.model_fields[name].get_default() for name in names]
    assert [float(word) for word in default.split(", ")] == found


@pytest.mark.parametrize(("key", "model"), [("courses", CourseSettings), ("phases", TrainingPhase)])
def test_parts_are_named_with_all_their_keys(key, model):
    assert set(re.findall(r"`(\w+)`", ROWS[key][0])) == model.model_fields.keys()
