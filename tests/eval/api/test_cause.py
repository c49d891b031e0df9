"""Sight and control of two policies are exchanged, and what runs are policies like any other."""

import shutil

import pytest
from command_line import ends

import nw_eval
from nw_base.errors import PolicyError
from nw_eval.api.cause import apart, write_crossed
from nw_policies import load_bundle
from nw_sim.sensors.build import check_card

SUITE = """\
nw-eval: 1
name: two-logs
robot: go1
policy: go1-parkour
trials: 4
seed: 7
scenes: [hurdles/one_low_carpet, hurdles/two_brick_dusk]
record: none
"""
WEAK = {"kp: 20": "kp: 13"}
SHORT_SIGHTED = {"{sensor: scandots}": "{sensor: scandots, offset: -0.6}"}


@pytest.fixture
def changed(tmp_path):
    """Return a function that writes the shipped policy with other lines on its card."""
    original = load_bundle("go1-parkour")

    def write(name, changes, more=""):
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(original.checkpoint, folder)
        text = original.card_text.replace("name: go1-parkour", f"name: {name}")
        for line, other in changes.items():
            assert line in text, text
            text = text.replace(line, other)
        (folder / "policy.yaml").write_text(text + more)
        return folder

    return write


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE)
    return path


def test_cards_say_in_what_two_policies_differ(changed):
    old = load_bundle("go1-parkour")
    weak = load_bundle(changed("weak", WEAK))
    blurred = load_bundle(changed("blurred", SHORT_SIGHTED))
    assert apart(old, weak).rest
    assert not apart(old, weak).sight
    assert apart(old, blurred).sight
    assert not apart(old, blurred).rest
    assert not apart(old, blurred).weights
    assert not any(vars(apart(old, old)).values())


def test_an_exchanged_policy_has_one_s_sensors_and_the_other_s_gains(changed, tmp_path):
    both = load_bundle(changed("both", WEAK | SHORT_SIGHTED, "cameras: {ego: {pitch: 0.1}}\n"))
    old = load_bundle("go1-parkour")
    one = load_bundle(write_crossed(tmp_path / "a", old, both, name="a"), checkpoint=old.checkpoint)
    other = load_bundle(
        write_crossed(tmp_path / "b", both, old, name="b"), checkpoint=old.checkpoint
    )
    assert check_card(one.card)
    assert check_card(other.card)
    assert apart(one, both) == apart(old, both).__class__(sight=False, rest=True, weights=False)
    assert apart(other, both) == apart(old, both).__class__(sight=True, rest=False, weights=False)
    assert one.card.cameras["ego"].pitch == 0.1
    assert not other.card.cameras


def test_networks_that_feed_a_policy_go_along_with_its_control(tmp_path):
    student = load_bundle("go1-act-depth")
    crossed = load_bundle(
        write_crossed(tmp_path / "a", student, student, name="a"),
        checkpoint=student.checkpoint,
    )
    assert crossed.checkpoint_digest == student.checkpoint_digest
    assert not any(vars(apart(student, crossed)).values())


def test_policies_that_see_in_other_ways_cannot_be_exchanged():
    with pytest.raises(PolicyError, match="cannot be swapped"):
        apart(load_bundle("go1-parkour"), load_bundle("go1-act-rgb"))
    with pytest.raises(PolicyError, match="cannot be swapped"):
        apart(load_bundle("stand"), load_bundle("stand"))


@pytest.mark.parametrize(
    ("changes", "answer"),
    [(WEAK, "control"), pytest.param(SHORT_SIGHTED, "perception", marks=pytest.mark.nightly)],
)
def test_attribute_names_what_a_policy_lost_by(changed, suite, tmp_path, capsys, changes, answer):
    worse = changed("worse", changes)
    run = tmp_path / "run"
    nw_eval.run(suite, policy=str(worse), out=run, workers=1)
    assert ends("attribute", run, "--baseline", "go1-parkour", "--cause", "-j", "1") == 0
    assert f"\n{answer}: worse loses" in capsys.readouterr().out
    for page in ("report.md", "report.html"):
        assert f"{answer}: worse loses" in (run / page).read_text()
    assert "Perception or control" in (run / "cause" / "cause.md").read_text()


def test_a_second_answer_has_a_folder_of_its_own(changed, suite, tmp_path):
    worse = changed("worse", WEAK)
    nw_eval.run(suite, policy=str(worse), out=tmp_path / "run", trials=1, workers=1)
    first = nw_eval.find_cause(tmp_path / "run", baseline="go1-parkour", workers=1)
    second = nw_eval.find_cause(tmp_path / "run", baseline="go1-parkour", workers=1, trials=2)
    assert (first.out.name, second.out.name) == ("cause", "cause-2")
    assert (first.cause.trials, second.cause.trials) == (2, 4)
