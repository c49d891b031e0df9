"""Real runs that take over what earlier ones have: what runs, what is compared, what is said."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from nw_base.errors import TrialError, UsageError
from nw_eval import api
from nw_eval.cli.verbs.options import summary
from nw_eval.engine import cache, provenance
from nw_eval.engine import known as knowing
from nw_eval.engine.cache import TrialStore, read_entry, write_entry
from nw_eval.engine.known import known_trials
from nw_eval.engine.listener import NullListener
from nw_eval.engine.plan import plan_jobs
from nw_eval.view.sources import kind_of, open_shelf
from nw_gate.results.evidence import run_leaf
from nw_gate.results.parquet import read_rows
from nw_gate.results.row import from_dict, rows_digest, to_dict
from nw_gate.results.run_folder import RunFolder

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: {policy}
trials: 3
seed: 7
episode: {{duration: 0.2}}
scenes: [flat/carpet_room]
record: none
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Work in a folder with a suite, and with a cache of its own, in all tests of this file."""
    folder = tmp_path_factory.mktemp("cached")
    (folder / "tiny.yaml").write_text(SUITE.format(policy="stand"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("NW_EVAL_CACHE", str(folder / "cache"))
        patch.setenv("NW_EVAL_CACHE_GB", "1")
        yield folder


@pytest.fixture(scope="module")
def filled(place):
    """Return the run that has filled the cache."""
    first = api.run("tiny.yaml", out=place / "first", workers=1)
    assert not any(row.cached for row in first.rows)
    assert first.info.cache.model_dump() == {"off": "", "reexecuted": 0, "differing": ()}
    return first


def test_a_run_of_more_trials_runs_those_and_one_of_the_others(filled, place):
    more = api.run("tiny.yaml", trials=5, out=place / "more", workers=1)
    ran = {row.seed_index for row in more.rows if not row.cached}
    assert len(more.rows) == 5
    assert {3, 4} < ran
    assert len(ran) == 3
    known = [row for row in more.rows if row.seed_index < 3]
    assert rows_digest(known) == rows_digest(filled.rows)
    words = "Cache: 2 of 5 results reused. 1 trial was re-run as a check"
    assert more.verdict.verdict == "RAN"
    assert f"{words} and matched." in " ".join(summary(more).split())
    for page in (more.page, more.html):
        assert "Cache: 2 of 5 results reused" in page.read_text()
    for row in more.rows:
        assert (more.folder / row.mcap_path).stat().st_size == row.mcap_bytes
    # The pages name a log as RUN/mcap/SCENE/TRIAL.mcap, whether its trial was taken over or not.
    for row in more.rows:
        named = more.folder / "mcap" / row.scene / f"{row.trial_id}.mcap"
        assert named.is_file()
        assert named.is_symlink() is row.cached
        assert kind_of(str(named), policy=None, scene=None) == "log"
        assert list(open_shelf(named).logs) == [row.trial_id]
    taken = next(row for row in more.rows if row.cached)
    named = more.folder / "mcap" / taken.scene / f"{taken.trial_id}.mcap"
    assert api.replay(named).is_identical
    assert api.foxglove_layout(named)
    with pytest.raises(UsageError, match="nosuch"):
        api.replay(named.with_stem("nosuch"))
    gated = api.judge(more.folder)
    assert rows_digest(gated.rows) == rows_digest(more.rows)
    assert api.verify(more.folder, offline=True).files.findings == ()
    resumed = api.run(None, resume=more.folder)
    assert rows_digest(resumed.rows) == rows_digest(more.rows)
    assert named.is_symlink()


def test_labels_name_a_run_and_change_none_of_its_results(filled, place):
    labelled = api.run("tiny.yaml", out=place / "labelled", workers=1, labels={"team": "legs"})
    assert labelled.info.labels["team"] == "legs"
    assert rows_digest(labelled.rows) == rows_digest(filled.rows)
    assert run_leaf(labelled.info) == run_leaf(filled.info)
    kept = read_rows(RunFolder(path=labelled.folder).trials)[1]
    assert json.loads(kept["labels"])["team"] == "legs"
    assert api.verify(labelled.folder, offline=True).exit_code == 0
    with pytest.raises(UsageError, match="no key"):
        api.run("tiny.yaml", out=place / "no-label", labels={"Team": "legs"})


@pytest.fixture
def forged(filled, tmp_path):
    """Forge all entries, with valid seals, and logs that are what they say; return the store."""
    store = TrialStore.of_user()
    shutil.copytree(store.folder, tmp_path / "true")
    for kept in list(store):
        row = to_dict(read_entry(kept.path).row)
        row |= {"outcome": "completed", "completed": True, "success": 1.0}
        row["waypoints_reached"] = row["waypoints_total"]
        write_entry(kept.path, from_dict(row), filled.folder / filled.rows[0].mcap_path)
    yield store
    shutil.rmtree(store.folder)
    shutil.copytree(tmp_path / "true", store.folder)


def test_a_result_that_was_tampered_with_is_found_and_no_result_is_believed(filled, forged, place):
    wrong = api.run("tiny.yaml", out=place / "wrong", workers=1)
    assert (wrong.verdict.verdict, wrong.exit_code) == ("INFRASTRUCTURE", 4)
    assert "has another result than in the cache of trials" in wrong.verdict.reasons[0]
    assert "start a new run" in wrong.verdict.reasons[0]
    assert not any(row.cached for row in wrong.rows)
    assert rows_digest(wrong.rows) == rows_digest(filled.rows)
    judged = api.judge(wrong.folder)
    assert judged.verdict.verdict == "INFRASTRUCTURE"
    resumed = api.run(None, resume=wrong.folder)
    assert resumed.verdict.verdict == "INFRASTRUCTURE"
    rows = [read_entry(each.path).row for each in forged]
    assert {row.outcome for row in rows} == {"timeout"}


@pytest.mark.usefixtures("forged")
def test_a_baseline_is_not_saved_of_results_that_differ(place):
    with pytest.raises(TrialError, match=r"has another result .*; remove reports/baseline-tiny-"):
        api.save_baseline("tiny.yaml", trials=1, workers=1)
    assert not (place / "reports" / "baselines").exists()


def jobs_and_known(place, *, suite="tiny.yaml", off="", listener=None, **changes):
    """Return the jobs of a plan, and what is known of them."""
    plan = api.plan(suite, **changes)
    folder = RunFolder(path=place / "nowhere")
    with known_trials(
        plan, folder, off=off, listener=listener or NullListener(), doubted=lambda: None
    ) as known:
        return plan_jobs(plan, folder), known


def misses(place, **changes):
    """Return whether nothing of a plan is known, although it could be."""
    jobs, known = jobs_and_known(place, **changes)
    assert not known.info.off
    return known.to_run(jobs) == list(jobs) and not known._expected


@pytest.fixture
def card(place):
    """Return a copy of the card, in a folder of its own."""
    folder = place / "copied"
    folder.mkdir(exist_ok=True)
    shipped = api.plan("tiny.yaml").bundle.folder / "policy.yaml"
    return Path(shutil.copy(shipped, folder))


@pytest.mark.usefixtures("filled")
def test_what_is_the_same_is_known_wherever_it_lies(place, card):
    assert not misses(place)
    card.write_text(card.read_text().replace("title: ", "title: Another title. "))
    assert not misses(place, policy=str(card))


@pytest.mark.usefixtures("filled")
def test_how_often_and_how_it_is_judged_is_in_no_key(place):
    text = (place / "tiny.yaml").read_text().replace("name: tiny", "name: other")
    text = text.replace("trials: 3", "trials: 2") + "gate: {success_rate: 0.5}\n"
    (place / "renamed.yaml").write_text(text)
    jobs, known = jobs_and_known(place, suite="renamed.yaml")
    assert len(jobs) == 2
    assert len(known.to_run(jobs)) == 1


@pytest.mark.usefixtures("filled")
@pytest.mark.parametrize("new", ["scale: 0.26", "scale: 0.25, kp: 21.0", "scale: 0.25, clip: 3.0"])
def test_a_card_that_says_anything_else_is_another_policy(place, card, new):
    card.write_text(card.read_text().replace("scale: 0.25", new))
    assert misses(place, policy=str(card))


@pytest.mark.usefixtures("filled")
@pytest.mark.parametrize("changes", [{"seed": 8}, {"record": "all"}], ids=str)
def test_other_trials_are_not_known(place, changes):
    assert misses(place, **changes)


@pytest.mark.usefixtures("filled")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("duration: 0.2", "duration: 0.22"),
        ("duration: 0.2", "duration: 0.2, contact_termination: false"),
        ("robot: go1", "robot: go1\nprotocol: neverwhere-2026"),
        ("record: none", "record: none\nperturb: {friction: [0.7]}"),
    ],
)
def test_a_suite_that_says_anything_else_of_a_trial_has_others(place, old, new):
    (place / "edited.yaml").write_text((place / "tiny.yaml").read_text().replace(old, new))
    assert misses(place, suite="edited.yaml")


def test_a_scene_is_known_by_what_is_in_it_and_by_its_looks(place):
    room = place / "room"
    room.mkdir()
    files = {
        "scene.yaml": "nw-scene: 1\nname: here\ntask: hurdles\nlicence: MIT\nsplat: looks.ply\n"
        "trail: [[1.0, 0.0, 0.0]]\n",
        "collision.yaml": "boxes: [{center: [1.0, 0.0, 0.0], half_size: [0.1, 0.1, 0.1]}]\n",
        "looks.ply": "ply\n",
    }
    text = (place / "tiny.yaml").read_text().replace("flat/carpet_room", "./room")
    (place / "there.yaml").write_text(text)

    def key_of(**changed):
        for name, content in (files | changed).items():
            (room / name).write_text(content)
        [job, *_], known = jobs_and_known(place, suite="there.yaml")
        return known.conditions.key(job)

    assert key_of() == key_of()
    renamed = files["scene.yaml"].replace("name: here", "name: there")
    assert key_of(**{"scene.yaml": renamed}) == key_of()
    others = {
        "scene.yaml": files["scene.yaml"].replace("1.0", "1.1"),
        "collision.yaml": files["collision.yaml"].replace("1.0", "1.1"),
        "looks.ply": "ply \n",
    }
    assert len({key_of(), *(key_of(**{name: content}) for name, content in others.items())}) == 4


@pytest.mark.usefixtures("filled")
@pytest.mark.parametrize(
    "module", ["mujoco", "numpy", "renderer", "cpu", "code"], ids=lambda name: f"another {name}"
)
def test_another_engine_knows_nothing(place, module, monkeypatch):
    real = provenance.engine_of
    monkeypatch.setattr(provenance, "engine_of", lambda *asked: real(*asked) | {module: "another"})
    assert misses(place)


@pytest.mark.usefixtures("filled")
@pytest.mark.parametrize("name", ["python", "libc", "architecture"])
def test_another_system_knows_nothing(place, name, monkeypatch):
    monkeypatch.setattr(knowing, "system", lambda: cache.system() | {name: "another"})
    assert misses(place)


def test_what_is_not_known_by_its_bytes_is_never_taken_over(place):
    plan = api.plan("tiny.yaml")
    assert not knowing._unfit(plan)
    bundles = {
        "the policy imports code": replace(plan.bundle, code_sha256="0" * 64),
        "the policy is an object": replace(plan.bundle, instance=object()),
        "the policy is on a server": replace(
            plan.bundle, card=plan.bundle.card.model_copy(update={"adapter": "remote"})
        ),
    }
    for why, bundle in bundles.items():
        assert knowing._unfit(replace(plan, bundle=bundle)) == why
    suite = plan.suite.model_copy(update={"plugins": {"tasks.mine": "mine 1.0"}})
    assert knowing._unfit(replace(plan, suite=suite)) == "the code of tasks.mine is not found"
    _, known = jobs_and_known(place, render="cuda")
    assert known.info.off == "--render cuda"
    jobs, known = jobs_and_known(place, off="--no-cache")
    assert known.info.off == "--no-cache"
    assert known.to_run(jobs) == list(jobs)


def test_a_cache_of_no_size_keeps_nothing(place, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "0")
    _, known = jobs_and_known(place)
    assert known.info.off == "NW_EVAL_CACHE_GB=0"


def test_an_invalid_size_is_refused_before_anything_is_written(place, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "much")
    with pytest.raises(UsageError, match="NW_EVAL_CACHE_GB is 'much'; give a size in GB"):
        api.run("tiny.yaml", out=place / "unbegun")
    assert not (place / "unbegun").exists()


def test_a_cache_that_cannot_be_opened_is_a_sentence(place, tmp_path, monkeypatch):
    told = []

    class Ears(NullListener):
        def message(self, text):
            told.append(text)

    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "trials").write_text("a file")
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    jobs, known = jobs_and_known(place, listener=Ears())
    assert known.to_run(jobs) == list(jobs)
    [message] = told
    assert message.startswith("results of earlier runs are not used, and none is kept for later: ")
    assert "trials" in known.info.off


@pytest.mark.nightly
@pytest.mark.usefixtures("place")
def test_a_log_that_was_reused_from_another_suite_is_identical(tmp_path):
    text = (
        "nw-eval: 1\nname: {}\nrobot: go1\npolicy: stand\ntrials: 3\nseed: 7\nrecord: failures\n"
        "episode: {{duration: 0.5}}\nscenes: [flat/carpet_room]\n"
    )
    for name in ("first", "second"):
        (tmp_path / f"{name}.yaml").write_text(text.format(name))
        found = api.run(tmp_path / f"{name}.yaml", out=tmp_path / name, workers=1)
    assert any(row.cached for row in found.rows)
    verified = api.verify(found.folder, trials="100%")
    assert all(each.is_identical for each in verified.repeats.trials)
    assert len(verified.repeats.trials) == 3
