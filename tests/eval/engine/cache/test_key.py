"""Whatever can change a result changes the key of its entry; what only names things does not."""

from dataclasses import fields, replace
from pathlib import Path

import pytest
from cache_parts import conditions_of, jobs_of
from hypothesis import given
from hypothesis import strategies as st

from nw_base.trials import Trial
from nw_eval.engine import cache
from nw_gate.results.run_folder import RunFolder
from nw_sim.rendering import Rendering
from nw_sim.rollout.job import TrialJob
from nw_sim.tasks import TaskSettings


class Other(TaskSettings):
    kind: str = "other"


TEXT, WHOLE = st.text(max_size=8), st.integers(0, 2**40)
REAL = st.floats(0.01, 600.0)
COUNTING = {
    "robot": TEXT,
    "protocol": st.sampled_from(["strict", "neverwhere-2026"]),
    "duration": REAL,
    "contact_termination": st.booleans(),
    "collision": st.sampled_from(["terrain", "triangles"]),
    "checkpoint_digest": TEXT,
    "operator": TEXT,
    "record": st.sampled_from(["all", "failures", "none", "summary"]),
    "render": st.sampled_from(["cpu", "cuda"]),
    "rendering": st.builds(
        Rendering, projection=st.sampled_from(["ewa", "ray"]), samples=st.sampled_from([1, 4])
    ),
    "task": st.builds(Other),
    "scores": st.tuples(TEXT),
}
COUNTING_OF_TRIAL = {
    "suite_digest": TEXT,
    "suite_seed": WHOLE,
    "scene_digest": TEXT,
    "task": TEXT,
    "index": WHOLE,
    "perturbation": st.tuples(st.tuples(TEXT, REAL)),
}
NAMING = {
    "scene": TEXT,
    "policy": TEXT,
    "policy_name": TEXT,
    "checkpoint": TEXT.map(Path),
    "robot_folder": TEXT.map(Path),
    "allow_code": st.booleans(),
    "mcap": TEXT.map(Path),
    "time_limit": REAL,
    "attachments": st.tuples(st.tuples(TEXT, TEXT)),
}
NAMING_OF_TRIAL = {
    "suite": TEXT,
    "scene": TEXT,
    "tier": st.sampled_from(["critical", "informational"]),
    "place": WHOLE,
}
[JOB] = jobs_of(RunFolder(path=Path("run")))


def names(kind):
    return {field.name for field in fields(kind)}


def test_every_field_of_a_job_is_known_to_count_or_not_to_count():
    assert {*COUNTING, *NAMING, "trial"} == names(TrialJob)
    assert {*COUNTING_OF_TRIAL, *NAMING_OF_TRIAL} == names(Trial)


def test_a_field_that_is_added_counts():
    assert names(TrialJob) - cache._CIRCUMSTANCE == {*COUNTING}
    assert names(Trial) - cache._LABELS == {*COUNTING_OF_TRIAL}


def changed(data, changes, changes_of_trial):
    """Return the job with one of some fields changed."""
    choices = [(JOB, *one) for one in changes.items()]
    choices += [(JOB.trial, *one) for one in changes_of_trial.items()]
    owner, name, values = data.draw(st.sampled_from(choices))
    before = getattr(owner, name)
    other = replace(owner, **{name: data.draw(values.filter(lambda value: value != before))})
    return other if owner is JOB else replace(JOB, trial=other)


@given(st.data())
def test_a_job_with_anything_else_in_it_has_another_key(data):
    other = changed(data, COUNTING, COUNTING_OF_TRIAL)
    assert conditions_of().key(other) != conditions_of().key(JOB)


@given(st.data())
def test_names_and_places_are_in_no_key(data):
    other = changed(data, NAMING, NAMING_OF_TRIAL)
    assert conditions_of().key(other) == conditions_of().key(JOB)


@given(st.data())
def test_other_conditions_make_other_keys_and_lie_elsewhere(data):
    one = conditions_of()
    field = data.draw(st.sampled_from(["policy", "engine", "system"]))
    before = getattr(one, field)
    values = TEXT if field == "policy" else st.dictionaries(st.sampled_from([*before, "new"]), TEXT)
    other = conditions_of(**{field: data.draw(values.filter(lambda value: value != before))})
    assert other.digest != one.digest
    assert other.key(JOB) != one.key(JOB)


def test_what_lies_beneath_the_libraries_is_told():
    assert all(cache.system().values())


@pytest.mark.parametrize("kind", [TrialJob, Trial])
def test_no_field_is_left_out_by_a_name_that_is_none(kind):
    known = cache._CIRCUMSTANCE if kind is TrialJob else cache._LABELS
    assert known <= names(kind)
