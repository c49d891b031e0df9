"""Configs of trainings are refused as suites are: every fault with its place and the fix."""

from pathlib import Path

import pytest

from nw_base.errors import UsageError
from nw_learn.config import TrainingConfig, load_config

GOOD = "nw-train: 1\nseed: 7\nbudget: {steps: 1000}\n"


def config(folder: Path, text: str) -> Path:
    path = folder / "config.yaml"
    path.write_text(text)
    return path


def test_a_config_says_what_its_file_does(tmp_path):
    found = load_config(config(tmp_path, GOOD), TrainingConfig)
    assert (found.seed, found.device, found.budget.steps, found.budget.minutes) == (
        7, "auto", 1000, None,
    )  # fmt: skip
    assert found.base == tmp_path


def test_all_faults_come_at_once_each_with_its_place_and_fix(tmp_path):
    path = config(tmp_path, "nw-train: 1\nseed: -1\nbudgets: {steps: 3}\nbudget: {steps: 0}\n")
    with pytest.raises(UsageError) as caught:
        load_config(path, TrainingConfig)
    lines = str(caught.value).splitlines()
    assert [line.removeprefix(f"{path}:").split(": ")[0] for line in lines] == [
        "2:1",
        "3:1",
        "4:10",
    ]
    assert lines[1].endswith("unknown key 'budgets'; did you mean 'budget'?")


def test_a_config_that_is_missing_is_an_error_on_one_line(tmp_path):
    with pytest.raises(UsageError, match=r"absent\.yaml:1:1: cannot be read"):
        load_config(tmp_path / "absent.yaml", TrainingConfig)


def test_the_digest_is_that_of_what_decides_the_curve(tmp_path):
    digest = load_config(config(tmp_path, GOOD), TrainingConfig).digest
    for same in ("device: cpu\n" + GOOD, GOOD.replace("1000}", "1000, minutes: 5}")):
        assert load_config(config(tmp_path, same), TrainingConfig).digest == digest
    for other in (GOOD.replace("seed: 7", "seed: 8"), GOOD.replace("1000", "1001")):
        assert load_config(config(tmp_path, other), TrainingConfig).digest != digest
