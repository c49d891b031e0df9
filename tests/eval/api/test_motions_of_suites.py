"""A suite that names the motion to track: its digest counts for trials, its faults have a place."""

import re
from types import SimpleNamespace

import pytest
import yaml

from nw_base.errors import PolicyError, SuiteError
from nw_eval import api
from nw_eval.api.proposals import write_proposal
from nw_eval.suite import load_suite

STANDING = "0,0,0.257,0,0,0,1," + ",".join(
    map(str, [-0.3, 0.78, -1.79, 0.3, 0.78, -1.79, -0.2, 1.07, -1.63, 0.2, 1.07, -1.63])
)
CARD = """\
nw-policy: 1
name: tracker
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
observations:
  motion: {sensor: reference, terms: [joint_positions]}
"""
SUITE = """\
nw-eval: 1
name: dances
robot: go1
policy: ./tracker
trials: 1
seed: 5
episode: {duration: 1.0}
task: {kind: track, start: 0.0, motion: {file: motions/stand.csv, rate: 1}}
scenes: [open/field]
record: none
"""


@pytest.fixture
def folder(tmp_path):
    """A suite beside the folder of its policy, and of its motion of two seconds."""
    for name in ("tracker", "motions"):
        (tmp_path / name).mkdir()
    (tmp_path / "tracker" / "policy.yaml").write_text(CARD)
    (tmp_path / "motions" / "stand.csv").write_text(f"{STANDING}\n" * 3)
    (tmp_path / "suite.yaml").write_text(SUITE)
    return tmp_path


def changed(folder, old, new):
    text = (folder / "suite.yaml").read_text()
    assert old in text
    (folder / "suite.yaml").write_text(text.replace(old, new))


def test_a_run_tracks_the_motion_of_its_suite_and_records_its_digest(folder):
    report = api.run(str(folder / "suite.yaml"), out=folder / "run", workers=1)
    (row,) = report.rows
    assert dict(row.scores)["joint_error"] < 0.3, "it stands as the motion does"
    said = report.info.suite["task"]["motion"]
    assert said["file"] == "motions/stand.csv"
    assert len(said["sha256"]) == 64


def test_its_digest_names_the_trials_and_its_place_does_not(folder):
    first = load_suite(folder / "suite.yaml").digest
    (folder / "motions" / "stand.csv").rename(folder / "motions" / "still.csv")
    changed(folder, "stand.csv", "still.csv")
    assert load_suite(folder / "suite.yaml").digest == first
    (folder / "motions" / "still.csv").write_text(f"{STANDING}\n" * 4)
    assert load_suite(folder / "suite.yaml").digest != first


def test_a_suite_that_names_no_motion_keeps_the_digest_that_it_had(folder):
    changed(folder, ", motion: {file: motions/stand.csv, rate: 1}", "")
    suite = load_suite(folder / "suite.yaml")
    assert "motion" not in suite.model_dump()["task"]
    with pytest.raises(SuiteError, match=r"suite.yaml:8:\d+: task: neither the suite nor the pol"):
        api.plan(str(folder / "suite.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "stand.csv",
            "stnd.csv",
            r"suite.yaml:8:\d+: task.motion.file: .*stnd.csv cannot be read: No such",
        ),
        (
            "motions/stand.csv",
            "motions",
            r"suite.yaml:8:\d+: task.motion.file: the motion motions cannot be read",
        ),
        (
            "rate: 1",
            f"rate: 1, sha256: {'a' * 64}",
            r"suite.yaml:8:\d+: task.motion.sha256: the SHA-256 of motions/stand.csv is [0-9a-f]+",
        ),
        ("rate: 1", "rate: 1, sha256: abc", r"suite.yaml:8:\d+: task.motion.sha256: "),
        ("rate: 1", "rate: 0", r"suite.yaml:8:\d+: task.*rate: must be at least 1"),
        ("rate: 1", "pace: 1", r"suite.yaml:8:\d+: unknown key 'pace'"),
    ],
)
def test_what_is_wrong_with_it_is_said_at_its_place(old, new, said, folder):
    changed(folder, old, new)
    with pytest.raises((SuiteError, PolicyError), match=said):
        load_suite(folder / "suite.yaml")


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        pytest.param("0,0,nothing\n", "with commas between", id="no numbers"),
        pytest.param(f"{STANDING}\n{STANDING[:-3]}x\n", "stand.csv", id="damaged at its end"),
        pytest.param("0,0,0.3,0,0,0,1,0.1\n" * 3, "has 1 joint without names", id="another robot"),
        pytest.param("PK\x03\x04 no archive", "not a usable .npz file", id="no archive"),
    ],
)
def test_a_broken_motion_is_a_fault_at_its_line_before_any_trial(motion, said, folder):
    (folder / "motions" / "stand.csv").write_text(motion)
    with pytest.raises(SuiteError, match=r"suite.yaml:8:\d+: task.motion.file: ") as error:
        api.plan(str(folder / "suite.yaml"))
    assert re.search(said, str(error.value))


def test_a_broken_motion_of_the_card_is_a_fault_before_any_trial(folder):
    changed(folder, ", motion: {file: motions/stand.csv, rate: 1}", "")
    (folder / "tracker" / "own.csv").write_text("0,0,0.3,0,0,0,1,0.1\n" * 3)
    (folder / "tracker" / "policy.yaml").write_text(CARD + "reference: {file: own.csv, rate: 1}\n")
    with pytest.raises(PolicyError, match=r"own\.csv: the motion has 1 joint without names"):
        api.plan(str(folder / "suite.yaml"))


def test_a_run_is_resumed_with_the_motion_that_it_began_with(folder):
    out = folder / "run"
    api.run(str(folder / "suite.yaml"), out=out, workers=1)
    saved = yaml.safe_load((folder / "suite.yaml").read_text())
    saved["trials"] = 2
    (folder / "suite.yaml").write_text(yaml.safe_dump(saved))
    report = api.run(str(folder / "suite.yaml"), resume=out, workers=1)
    assert len(report.rows) == 2


def test_a_motion_that_is_too_large_to_be_one_is_not_read(folder):
    with (folder / "motions" / "stand.csv").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(SuiteError, match=r"task.motion.file: .* cannot be read: it has .* MiB"):
        load_suite(folder / "suite.yaml")


def test_a_fault_of_the_file_names_the_suite_and_not_the_card(folder):
    changed(folder, ", rate: 1", "")
    with pytest.raises(SuiteError, match=r"add `rate` to the suite's `task\.motion`"):
        api.run(str(folder / "suite.yaml"), out=folder / "run", workers=1)
    (folder / "tracker" / "own.csv").write_text(f"{STANDING}\n{STANDING}\n")
    (folder / "tracker" / "policy.yaml").write_text(CARD + "reference: {file: own.csv}\n")
    changed(folder, ", motion: {file: motions/stand.csv}", "")
    with pytest.raises(PolicyError, match="add `rate` to the card's `reference`"):
        api.run(str(folder / "suite.yaml"), out=folder / "run", workers=1)


def test_a_suite_that_is_proposed_in_another_folder_has_the_same_task(folder):
    plan = api.plan(str(folder / "suite.yaml"))
    items = (SimpleNamespace(stratum=("open/field",), critical=False),)
    proposal = SimpleNamespace(items=items, rounds=20, starts=10)
    policy = SimpleNamespace(typed="", name="tracker")
    file = folder / "proposed" / "sharp.yaml"
    file.parent.mkdir()
    write_proposal(file, plan, proposal, policy, [])
    written = load_suite(file)
    assert written.motion is not None
    assert written.motion.samefile(folder / "motions" / "stand.csv")
    assert written.task.model_dump(exclude={"motion"}) == plan.suite.task.model_dump(
        exclude={"motion"}
    )
