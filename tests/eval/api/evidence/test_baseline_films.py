"""The baseline's policy is filmed from the initial states of the worst trials."""

from dataclasses import replace

import pytest

from nw_base.errors import TrialError
from nw_eval.api import evidence_baseline
from nw_eval.api.evidence import KeptEvidence
from nw_eval.api.evidence_baseline import with_baseline_films
from nw_gate.results.baseline import BaselinePolicy
from nw_gate.results.evidence_check import present_logs
from nw_gate.results.provenance import BaselineInfo
from nw_gate.results.run_folder import RunFolder
from nw_policies import find_card, load_bundle
from nw_sim.rollout.replaying import apart


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "evidence"
    folder.mkdir()
    return KeptEvidence(folder=folder, policy=("card", "checkpoint"))


def saved_with(name):
    """The policy of a baseline that was saved with a shipped policy."""
    bundle = load_bundle(find_card(name))
    return BaselinePolicy(
        name=bundle.name,
        adapter=bundle.card.adapter,
        card=str(bundle.card_path),
        checkpoint_digest=bundle.checkpoint_digest,
        card_digest=bundle.digest,
    )


@pytest.fixture
def filmed(recorded):
    """Film a baseline's policy beside the recorded run, which counts as one of another policy."""

    def film(policy, kept, *, runs=True, is_other=True):
        folder = RunFolder(path=recorded.folder)
        baseline = BaselineInfo(name="shipped", path="shipped.parquet", sha256="00" * 32)
        facts = {"baseline": baseline}
        if is_other:
            own = recorded.info.policy.model_copy(update={"card_digest": "11" * 32})
            facts["policy"] = own
        return with_baseline_films(
            recorded.evidence,
            folder,
            recorded.info.model_copy(update=facts),
            {row.trial_id: row for row in recorded.rows},
            present_logs(folder, recorded.rows),
            policy=policy,
            rivals={},
            kept=kept,
            runs=runs,
        )

    return film


def test_a_film_of_the_same_policy_is_the_candidate_s_own(recorded, filmed, store):
    """From the same initial state it does the same, so that both films are alike byte for byte."""
    found = filmed(saved_with(recorded.info.policy.name), store)
    assert found.remarks == recorded.evidence.remarks
    for clip in found.clips:
        assert clip.outside is not None
        assert clip.baseline == clip.outside
        assert clip.baseline_caption.startswith("baseline shipped from the same initial state, ")


def test_another_policy_looks_otherwise_and_is_filmed_once(recorded, filmed, store, monkeypatch):
    other = saved_with("go1-parkour")
    found = filmed(other, store)
    assert found.remarks == recorded.evidence.remarks
    for clip in found.clips:
        assert clip.baseline is not None
        assert clip.baseline.data != clip.outside.data

    def made_again(*_):
        raise AssertionError("films are kept")

    monkeypatch.setattr(evidence_baseline, "_made", made_again)
    assert filmed(other, store).clips == found.clips
    # Of a run that somebody else may have made nothing runs, and what is kept is shown.
    assert filmed(other, store, runs=False).clips == found.clips
    assert filmed(other, None, runs=False) == recorded.evidence


def test_a_policy_that_changed_since_is_not_shown_and_said(recorded, filmed):
    changed = saved_with("go1-parkour").model_copy(update={"card_digest": "22" * 32})
    found = filmed(changed, None)
    assert found.clips == recorded.evidence.clips
    (remark,) = found.remarks[len(recorded.evidence.remarks) :]
    assert remark.startswith("The baseline's policy is not shown beside the worst trials: ")
    assert remark.endswith("is no longer the policy that the baseline was saved with.")


def test_a_trial_that_fails_costs_its_own_film_and_is_named(recorded, filmed, monkeypatch):
    lost = recorded.evidence.clips[0].trial_id
    works = apart.take_over_apart

    def fails_once(path, **settings):
        if path.name == f"{lost}.mcap":
            raise TrialError("the policy gave no answer")
        return works(path, **settings)

    monkeypatch.setattr(apart, "take_over_apart", fails_once)
    found = filmed(saved_with("go1-parkour"), None)
    assert [clip.trial_id for clip in found.clips if clip.baseline is None] == [lost]
    assert found.remarks[-1] == (
        f"The baseline's policy is not shown beside {lost}: its trial could not be run or drawn."
    )


def test_the_baseline_s_own_policy_is_not_shown_twice(recorded, filmed):
    own = saved_with(recorded.info.policy.name)
    assert filmed(own, None, is_other=False) == recorded.evidence


def test_a_run_without_a_film_of_its_own_has_none_of_the_baseline(recorded):
    bare = replace(
        recorded.evidence,
        clips=tuple(replace(clip, outside=None) for clip in recorded.evidence.clips),
    )
    found = with_baseline_films(
        bare, RunFolder(path=recorded.folder), recorded.info, {}, {},
        policy=saved_with("go1-parkour"), rivals={}, kept=None, runs=True,
    )  # fmt: skip
    assert found == bare
