"""Perception or control: the parts add up, and what is named is no chance."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_base.errors import StoreError
from nw_eval.reporting.tables.cause import answer_words, cause_table
from nw_gate.cause import ARMS, Apart, cause_of, read_cause_file, write_cause_file

ALL = Apart(sight=True, rest=True, weights=True)


def rows(successes, first=0):
    return [
        SimpleNamespace(trial_id=f"t{n:03d}", success=y, completed=None if y is None else y == 1.0)
        for n, y in enumerate(successes, first)
    ]


def arms(**successes):
    """Return the four policies' rows, by control and sight: `old_new` is old control, new sight."""
    return {arm: rows(successes["_".join(arm)]) for arm in ARMS}


def drawn(rng, trials, **chances):
    """Return rows of which each completes with its policy's chance."""
    return arms(**{
        name: (rng.random(trials) < chance).astype(float).tolist()
        for name, chance in chances.items()
    })  # fmt: skip


SHARES = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])


@given(st.lists(st.tuples(SHARES, SHARES, SHARES, SHARES), min_size=1, max_size=12))
def test_sight_and_control_add_up_to_the_drop(scores):
    names = ("old_old", "old_new", "new_old", "new_new")
    cause = cause_of(
        arms(**{n: list(y) for n, y in zip(names, zip(*scores, strict=True), strict=True)}), ALL
    )
    assert cause.sight.size + cause.control.size == pytest.approx(cause.drop.size)


def test_who_loses_by_new_sight_alone_loses_by_perception():
    cause = cause_of(
        arms(old_old=[1.0] * 16, old_new=[0.5] * 16, new_old=[1.0] * 16, new_new=[0.5] * 16), ALL
    )
    assert (cause.answer, cause.sight.size, cause.control.size) == ("perception", 0.5, 0.0)
    assert cause.regressed == 16
    assert [arm.regressed for arm in cause.arms] == [16, 0, 16, 0]


def test_who_loses_by_new_control_alone_loses_by_control():
    cause = cause_of(
        arms(old_old=[1.0] * 8, old_new=[1.0] * 8, new_old=[0.0] * 8, new_new=[0.0] * 8), ALL
    )
    assert (cause.answer, cause.sight.size, cause.control.size) == ("control", 0.0, 1.0)
    assert "networks" in cause.why


def test_both_are_named_where_each_costs_its_part():
    cause = cause_of(
        arms(old_old=[1.0] * 12, old_new=[0.5] * 12, new_old=[0.5] * 12, new_new=[0.0] * 12), ALL
    )
    assert cause.answer == "both"


def test_a_policy_that_is_not_worse_has_nothing_to_explain():
    same = [1.0, 0.5, 1.0, 0.0] * 3
    cause = cause_of(arms(old_old=same, old_new=same, new_old=same, new_new=same), ALL)
    assert cause.answer == "no drop"


def test_another_checkpoint_behind_the_same_sensors_cannot_be_told_apart():
    lost = arms(old_old=[1.0] * 9, old_new=[1.0] * 9, new_old=[0.0] * 9, new_new=[0.0] * 9)
    cause = cause_of(lost, Apart(sight=False, rest=True, weights=True))
    assert cause.answer == "cannot tell"
    assert "cannot be separated by swapping sensors" in cause.why
    assert cause_of(lost, Apart(sight=False, rest=True, weights=False)).answer == "control"


def test_too_few_trials_leave_open_which_it_is():
    cause = cause_of(
        arms(
            old_old=[1.0] * 6,
            old_new=[1.0, 0.0] * 3,
            new_old=[0.0, 1.0] * 3,
            new_new=[0.0] * 6,
        ),
        ALL,
    )
    assert cause.answer == "cannot tell"
    assert "few trials" in cause.why


def test_trials_that_one_of_the_four_did_not_end_are_left_out_and_counted():
    four = arms(
        old_old=[1.0, 1.0, None], old_new=[1.0] * 3, new_old=[0.0] * 3, new_new=[0.0, 0.0, 0.0]
    )
    four["new", "old"].append(*rows([1.0], first=9))
    cause = cause_of(four, ALL)
    assert (cause.trials, cause.left_out) == (2, 2)
    with pytest.raises(ValueError, match="no trial"):
        cause_of(arms(old_old=[None], old_new=[1.0], new_old=[1.0], new_new=[1.0]), ALL)


@pytest.mark.parametrize(
    ("rest", "named"),
    [
        ("control", "perception"),
        pytest.param("perception", "control", marks=pytest.mark.nightly),
    ],
)
def test_an_effect_that_is_none_is_seldom_named(rest, named):
    rng, wrong, right = np.random.default_rng(11), 0, 0
    for _ in range(200):
        bad = 0.4
        by_control = rest == "control"
        answer = cause_of(
            drawn(
                rng,
                60,
                old_old=0.9,
                old_new=0.9 if by_control else bad,
                new_old=bad if by_control else 0.9,
                new_new=bad,
            ),
            ALL,
        ).answer
        wrong += answer in {named, "both"}
        right += answer == rest
    assert wrong / 200 < 0.08
    assert right / 200 > 0.85


SKEWED = np.array([0.1, -0.9]), [0.9, 0.1]
"""Parts of the drop with mean 0: tests that suppose symmetry find an effect in 13 to 20 %."""


def of_parts(sight, control):
    """Return rows of four policies whose trials have these parts, sight above -1/2."""
    lost, crossed = sight + control, sight - control
    four = {"old_old": 1.0, "new_new": 1.0 - lost, "old_new": 1.0, "new_old": 1.0 + crossed}
    return arms(**{name: (y + np.zeros(len(lost))).tolist() for name, y in four.items()})


@pytest.mark.parametrize("trials", [16, pytest.param(32, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.nightly)])
def test_skewed_parts_with_mean_0_are_named_as_seldom_as_said(trials, sign):
    rng, times = np.random.default_rng(5), 200
    line = 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / times)
    found = {"drop": 0, "perception": 0, "low": 0, "high": 0}
    values, chances = SKEWED
    for _ in range(times):
        none = sign * rng.choice(values, trials, p=chances)
        still = np.zeros(trials)
        found["drop"] += cause_of(of_parts(none, still), ALL).answer != "no drop"
        cause = cause_of(of_parts(none / 2.0, still + 0.5), ALL)
        found["perception"] += cause.answer in {"perception", "both"}
        low, high = cause.sight.interval
        found["low"] += low > 0.0
        found["high"] += high < 0.0
    assert {name: count / times <= line for name, count in found.items()} == dict.fromkeys(
        found, True
    ), found


def test_without_a_drop_one_is_found_as_seldom_as_said():
    rng, times = np.random.default_rng(7), 200
    found = 0
    for _ in range(times):
        none = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], 32, p=[0.1, 0.1, 0.6, 0.1, 0.1])
        found += cause_of(of_parts(none, np.zeros(32)), ALL).answer != "no drop"
    assert found / times <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / times)


@pytest.mark.parametrize("trials", [32, 48])
def test_an_effect_of_three_tenths_is_found_in_most(trials):
    rng, found, names = np.random.default_rng(9), 0, 0
    for _ in range(100):
        effect = rng.choice([-0.5, 0.0, 0.5, 1.0], trials, p=[0.1, 0.4, 0.3, 0.2])
        cause = cause_of(of_parts(effect, np.zeros(trials)), ALL)
        low, high = cause.sight.interval
        found += cause.answer == "perception"
        names += low <= 0.3 <= high
    assert found > 70
    assert names > 90


def test_a_part_is_named_only_after_the_drop_was():
    # Each part alone would be shown; the whole is what is asked for first.
    gain, loss = -np.ones(16) / 2.0, np.ones(16) / 2.0
    cause = cause_of(of_parts(loss, gain), ALL)
    assert cause.answer == "no drop"
    assert cause.sight.p >= cause.drop.p > 0.05
    assert cause.sight.interval.low > 0.0 > cause.control.interval.high


def test_a_file_of_an_earlier_version_has_no_intervals(tmp_path):
    path = tmp_path / "cause.json"
    lost = arms(old_old=[1.0] * 9, old_new=[0.0] * 9, new_old=[1.0] * 9, new_new=[0.0] * 9)
    write_cause_file(cause_of(lost, ALL), path)
    kept = json.loads(path.read_text())
    for part in ("drop", "sight", "control"):
        del kept[part]["interval"]
    path.write_text(json.dumps(kept))
    assert "+1.000 by sight (p 0." in answer_words(read_cause_file(path))


def test_it_is_kept_in_a_file_and_damage_is_said(tmp_path):
    lost = arms(old_old=[1.0] * 9, old_new=[0.0] * 9, new_old=[1.0] * 9, new_new=[0.0] * 9)
    cause = cause_of(lost, ALL, old="ships", new="tilted")
    path = tmp_path / "cause.json"
    assert read_cause_file(path) is None
    write_cause_file(cause, path)
    assert read_cause_file(path) == cause
    assert "perception: tilted loses 1.000 against ships in 9 trials" in answer_words(cause)
    assert "+1.000 by sight (+0." in answer_words(cause)
    assert " to +1.00 at 95 % each, p 0.0" in answer_words(cause)
    table = cause_table(cause)
    assert table.rows[1] == ("ships (old)", "tilted (new)", "0.000", "0 of 9", "0 of 9")
    assert cause_table(None).rows == ()
    path.write_text('{"old": 3}')
    with pytest.raises(StoreError, match="damaged"):
        read_cause_file(path)
