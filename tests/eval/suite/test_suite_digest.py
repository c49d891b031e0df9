from __future__ import annotations

from hashlib import sha256
from typing import Any

import pytest

from nw_base.trials import _USUAL, digest_of_trials
from nw_eval.suite import Suite, load_suite, new_suite
from nw_eval.suite.model import Source
from nw_sim.rendering import PUBLISHED
from nw_sim.tasks import COURSE

BASE: dict[str, Any] = {
    "nw-eval": 1,
    "name": "hurdles",
    "robot": "go1",
    "policy": "go1-parkour",
    "trials": 10,
    "seed": 20261,
    "scenes": ["hurdles/*"],
}


def suite(**changes: Any) -> Suite:
    return new_suite({**BASE, **changes})


def test_the_digest_is_the_hash_of_the_settings_that_decide_a_trial() -> None:
    # Written out by hand, so that no refactoring renames every trial that was ever run.
    text = (
        '{"episode":{"duration":12.0},"perturb":{},"protocol":"strict","robot":"go1","seed":20261}'
    )
    assert suite().digest == sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    "change",
    [
        {"trials": 50},
        {"policy": "other"},
        {"name": "other"},
        {"record": "all"},
        {"gate": {"success_rate": 0.9}},
        {"scenes": ["hurdles/one_low_carpet"]},
    ],
)
def test_settings_that_leave_a_trial_as_it_is_leave_the_digest(change: dict[str, Any]) -> None:
    assert suite(**change).digest == suite().digest
    assert suite(**change).content_digest != suite().content_digest


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 20262},
        {"protocol": "neverwhere-2026"},
        {"episode": {"duration": 11.0}},
        {"episode": {"contact_termination": False}},
        {"perturb": {"friction": [0.6]}},
        {"render": {"projection": "ray"}},
        {"render": {"samples": 4}},
        {"render": {"near": 0.2}},
    ],
)
def test_settings_that_change_a_trial_change_the_digest(change: dict[str, Any]) -> None:
    assert suite(**change).digest != suite().digest


def test_whole_seconds_and_decimals_are_the_same_number() -> None:
    assert suite(episode={"duration": 12}).digest == suite(episode={"duration": 12.0}).digest


def test_pictures_as_published_are_those_of_suites_that_say_nothing() -> None:
    published = suite(render={"projection": "ewa", "samples": 1, "near": 0.01})
    assert published.digest == suite().digest
    assert published.content_digest == suite().content_digest


def test_where_a_suite_was_written_is_no_part_of_it() -> None:
    elsewhere = new_suite(BASE, Source(file="/elsewhere.yaml", places={(): (3, 1)}))
    assert elsewhere == suite()
    assert elsewhere.content_digest == suite().content_digest


def test_settings_that_a_suite_leaves_out_are_those_under_which_digests_are_as_before():
    suite = load_suite("hurdles")
    assert suite.task == COURSE
    assert suite.render != PUBLISHED
    plain = new_suite({**suite.model_dump(by_alias=True), "render": PUBLISHED.model_dump()})
    assert {"task": COURSE.model_dump(), "render": PUBLISHED.model_dump()} == _USUAL
    said = {**plain.model_dump(), "task": COURSE.model_dump(), "render": PUBLISHED.model_dump()}
    assert digest_of_trials(said) == plain.digest != suite.digest
