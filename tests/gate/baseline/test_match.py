from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from nw_base.errors import IncomparableError
from nw_gate.baseline.match import check_match
from nw_gate.results.baseline import key_of, machine_of
from nw_gate.results.provenance import SceneInfo
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from nw_gate.results.baseline import BaselineResults
    from nw_gate.results.provenance import RunInfo


RENEW = (
    "; renew the baseline with `nw-eval baseline save hurdles --policy go1-act-rgb --renew "
    "--name shipped`"
)


@pytest.fixture
def run(make_run):
    return make_run(["a", "b"], 10)


@pytest.fixture
def baseline(run, make_baseline):
    return make_baseline(run, {"a": [1.0] * 30, "b": [1.0] * 30})


def refusal(run: RunInfo, baseline: BaselineResults) -> str:
    with pytest.raises(IncomparableError) as caught:
        check_match(run, baseline)
    assert caught.value.exit_code == 5
    prefix = f"baseline shipped is not compatible with run {run.id}: "
    message = str(caught.value)
    assert message.startswith(prefix)
    assert message.endswith(RENEW)
    assert "\n" not in message
    return message.removeprefix(prefix).removesuffix(RENEW)


def test_a_baseline_of_the_same_world_matches(run, baseline):
    check_match(run, baseline)
    # The class of machine is no part of it, nor are the number of trials and the gate.
    elsewhere = {**run.engine, "cpu": "haswell", "torch": "2.9", "code": "0" * 16}
    changed = {**run.suite, "trials": 3, "gate": {**run.suite["gate"], "max_drop": 0.3}}
    check_match(run.model_copy(update={"engine": elsewhere, "suite": changed}), baseline)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"seed": 5}, "its seed is 5, the baseline's 20261"),
        ({"protocol": "neverwhere-2026"}, "its protocol is neverwhere-2026, the baseline's strict"),
    ],
)
def test_what_names_the_starts_is_named_with_both_values(make_run, baseline, settings, words):
    assert refusal(make_run(["a", "b"], 10, suite=settings), baseline) == words


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"robot": "go2"}, "robot, task, episode, pictures or version of a plug-in differ"),
        (
            {"episode": {"duration": 20.0}},
            "robot, task, episode, pictures or version of a plug-in differ",
        ),
        (
            {"perturb": {"friction": (0.6, 1.0)}},
            "perturb is friction 0.6, friction 1, the baseline's ",
        ),
    ],
)
def test_of_a_suite_of_which_a_baseline_knows_the_digest_only_what_can_be_told_is_told(
    make_run, baseline, settings, words
):
    run = make_run(["a", "b"], 10, suite=settings)
    digests = f"{run.suite_digest[:8]}, the baseline's {baseline.manifest.key.suite_digest[:8]}"
    assert refusal(run, baseline).startswith(f"its suite digest is {digests}: {words}")


@pytest.mark.parametrize("name", ["mujoco", "rays", "renderer"])
def test_another_version_of_the_simulator_is_another_world(run, baseline, name):
    newer = run.model_copy(update={"engine": {**run.engine, name: "9.9"}})
    assert refusal(newer, baseline) == f"its {name} is 9.9, the baseline's {run.engine[name]}"
    without = {key: value for key, value in run.engine.items() if key != name}
    assert refusal(run.model_copy(update={"engine": without}), baseline).startswith(
        f"its {name} is none, the baseline's "
    )


def test_scenes_are_named_that_are_in_one_and_not_in_the_other_or_have_changed(
    run, baseline, make_run
):
    assert refusal(make_run(["a", "b", "c"], 10), baseline) == "scene c is not in the baseline"
    fewer = make_run(["a"], 10)
    assert refusal(fewer, baseline) == "scene b is in the baseline and not in the run"
    changed = {**run.scenes, "b": SceneInfo(digest="99" * 32, task="hurdles", trials=10)}
    assert refusal(run.model_copy(update={"scenes": changed}), baseline) == (
        "scene b has changed (99999999 now, dddddddd in the baseline)"
    )


def test_a_run_that_was_asked_for_some_scenes_is_compared_in_those(make_run, baseline):
    run = make_run(["a"], 10, request=Request(suite="hurdles", scenes=("a",)))
    check_match(run, baseline)


def test_every_fault_is_told_at_once(make_run, baseline):
    run = make_run(["a", "c"], 10, suite={"seed": 5}, engine={})
    words = refusal(run, baseline)
    for part in ("seed is 5", "scene c is not", "scene b is in the baseline", "mujoco is none"):
        assert part in words


def test_fresh_starts_are_of_another_seed_and_of_no_other_difference(make_run, baseline):
    check_match(make_run(["a", "b"], 10, panel="fresh", suite={"seed": 5}), baseline)
    same = refusal(make_run(["a", "b"], 10, panel="fresh"), baseline)
    assert same == "its seed 20261 is the baseline's, so its initial states are not fresh"
    other = make_run(["a", "b"], 10, panel="fresh", suite={"seed": 5, "robot": "go2"})
    assert refusal(other, baseline).endswith(
        "robot, task, episode, pictures or version of a plug-in differ"
    )


def test_the_command_names_the_suite_and_the_policy_as_they_can_be_typed_here(
    make_run, make_baseline
):
    run = make_run(["a"], 10, request=Request(suite="my suites/own.yaml"))
    baseline = make_baseline(run, {"a": [1.0]})
    policy = baseline.manifest.policy.model_copy(update={"card": "policies/own/policy.yaml"})
    baseline = replace(baseline, manifest=baseline.manifest.model_copy(update={"policy": policy}))
    with pytest.raises(IncomparableError) as caught:
        check_match(run.model_copy(update={"engine": {}}), baseline)
    assert str(caught.value).endswith(
        "`nw-eval baseline save 'my suites/own.yaml' --policy policies/own/policy.yaml --renew "
        "--name shipped`"
    )


@pytest.mark.parametrize("whose", [f"leaning 1.1 {'a' * 64}", f"leaning 1.0 {'b' * 64}"])
def test_a_score_of_another_version_or_code_than_the_baselines_is_not_compared(
    run, baseline, whose
):
    before = run.model_copy(update={"plugins": {"scores.lean": f"leaning 1.0 {'a' * 64}"}})
    manifest = baseline.manifest.model_copy(update={"key": key_of(before), "scores": ("lean",)})
    measured = replace(baseline, manifest=manifest)
    now = before.model_copy(
        update={
            "plugins": {"scores.lean": whose, "sensors.beam": "beams 2.0"},
            "engine": {**run.engine, "scores.lean": whose[:28]},
        }
    )
    check_match(before, measured)
    short = f"leaning {whose.split()[1]} {whose[-8:]}"
    words = f"its scores.lean is {short}, the baseline's leaning 1.0 {'a' * 8}"
    assert refusal(now, measured) == words
    # A score changes no bit of a trial, so the class of machine is the same.
    assert machine_of(now) == machine_of(before)
    check_match(now, baseline)
