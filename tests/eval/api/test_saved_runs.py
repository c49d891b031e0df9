"""Run folders judged again: two copies of the rows, a plan that decides which count."""

import json
from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import ends
from saved_runs import info_of, row_of

from nw_base.errors import StoreError
from nw_base.trials import Trial
from nw_eval import api
from nw_eval.cli.verbs.options import summary
from nw_eval.suite import new_suite
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.parquet import SCHEMA
from nw_gate.results.provenance import (
    SceneInfo,
    read_run_info,
    write_run_info,
)
from nw_gate.results.run_folder import RunFolder
from nw_gate.results.sealed import sealed

SUITE = new_suite(
    {
        "nw-eval": 1,
        "name": "quick",
        "robot": "go1",
        "policy": "stand",
        "trials": 6,
        "seed": 5,
        "scenes": ["hurdles/one"],
        "gate": {"success_rate": 0.3},
    }
)
SCENES = {"hurdles/one": SceneInfo(digest="dd" * 32, task="hurdles", trials=6)}
CHECKPOINT = "cc" * 32


def trial(index):
    return Trial(
        suite="quick",
        suite_digest=SUITE.digest,
        suite_seed=5,
        scene="hurdles/one",
        scene_digest="dd" * 32,
        task="hurdles",
        index=index,
    )


def row(trial, reached=4, **changes):
    path = f"mcap/{trial.scene}/{trial.id}.mcap"
    return row_of(trial, reached, **{"mcap_path": path, **changes})


HEADER = JournalHeader(
    suite_digest=SUITE.digest, policy_digest="p", scene_digests={"hurdles/one": "dd" * 32}
)


@pytest.fixture
def saved(tmp_path):
    """Return a maker of run folders: `saved(rows, trials=6, ended=True)`."""

    def make(rows, *, trials=6, ended=True, **changes):
        folder = RunFolder(path=tmp_path / "run")
        folder.path.mkdir(exist_ok=True)
        suite = SUITE.model_dump(by_alias=True, mode="json") | {"trials": trials}
        scenes = {
            name: scene.model_copy(update={"trials": trials}) for name, scene in SCENES.items()
        }
        info = info_of(SUITE, scenes, **{"suite": suite, **changes})
        write_run_info(folder.run_json, info)
        with Journal.create(folder.journal, HEADER) as journal:
            for one in rows:
                journal.append(one)
        if ended:
            planned = {trial(index).id for index in range(trials)}
            info = write_trials(folder, info, [one for one in rows if one.trial_id in planned])
            write_run_info(folder.run_json, info.model_copy(update={"finished": "later"}))
        return folder

    return make


def flip(path, place=0.5):
    data = bytearray(path.read_bytes())
    data[int(len(data) * place)] ^= 4
    path.write_bytes(data)


ROWS = [row(trial(index)) for index in range(6)]


def test_a_damaged_parquet_file_is_written_again_from_the_journal(saved):
    folder = saved(ROWS)
    whole = folder.trials.read_bytes()
    first = api.report(folder.path)
    assert first.verdict.verdict == "PASS"
    flip(folder.trials)
    again = api.report(folder.path)
    assert again.rows == first.rows
    assert again.verdict.verdict == "PASS"
    [said] = [text for text in again.verdict.reasons if "written again" in text]
    assert "trials.parquet is missing or damaged" in said
    assert folder.trials.read_bytes() == whole
    assert api.report(folder.path).verdict == first.verdict


def test_a_damaged_journal_of_an_ended_run_costs_nothing(saved):
    folder = saved(ROWS)
    first = api.report(folder.path)
    flip(folder.journal)
    again = api.report(folder.path)
    assert again.rows == first.rows
    assert "judged from trials.parquet" in again.verdict.reasons[-1]
    folder.journal.unlink()
    assert api.report(folder.path).rows == first.rows


def test_two_damaged_copies_are_no_result(saved, capsys):
    folder = saved(ROWS)
    flip(folder.journal)
    flip(folder.trials)
    with pytest.raises(StoreError, match=r"journal\.jsonl:\d+: damaged .*trials\.parquet is"):
        api.report(folder.path)
    assert ends("report", folder.path) == 4
    assert capsys.readouterr().err.count("\n") == 1


def test_a_parquet_file_that_kills_its_reader_is_no_result_and_kills_nobody_else(saved):
    folder = saved(ROWS)
    folder.journal.unlink()
    table = pq.read_table(folder.trials)
    # One long word in every row: a few kilobytes that unpack to gigabytes.
    words = pa.DictionaryArray.from_arrays(pa.array([0] * 20_000, pa.int32()), ["x" * 10**6])
    column = table.schema.get_field_index("host")
    many = table.take([0] * 20_000)
    pq.write_table(many.set_column(column, SCHEMA.field("host"), words), folder.trials)
    folder.trials.write_bytes(sealed(folder.trials.read_bytes()))
    with pytest.raises(StoreError, match=r"no journal at .*; and .*trials\.parquet"):
        api.report(folder.path)


def test_rows_of_another_run_are_noticed_by_their_digest(saved, tmp_path):
    folder = saved(ROWS)
    worse = [row(trial(index), reached=0) for index in range(6)]
    for path in (folder.trials, folder.journal):
        path.rename(tmp_path / path.name)
    info = read_run_info(folder.run_json)
    with Journal.create(folder.journal, HEADER) as journal:
        for one in worse:
            journal.append(one)
    write_trials(folder, info, worse)
    write_run_info(folder.run_json, info)
    with pytest.raises(StoreError, match=r"other rows than run\.json records"):
        api.report(folder.path)
    (tmp_path / "trials.parquet").replace(folder.trials)
    assert api.report(folder.path).verdict.success == 1.0


def test_a_journal_as_it_was_at_the_end_is_not_compared_with_the_plan_again(saved, monkeypatch):
    folder = saved(ROWS)
    monkeypatch.setattr(Trial, "seed", property(lambda _: pytest.fail("a seed was reckoned")))
    assert len(api.report(folder.path).rows) == 6


def test_an_older_parquet_file_does_not_hide_what_a_resumed_run_has_done_since(saved):
    folder = saved(ROWS[:4])
    info = read_run_info(folder.run_json)
    # As a resumed run does, which is killed after two more trials.
    write_run_info(folder.run_json, info.model_copy(update={"rows_digest": "", "finished": None}))
    with Journal.resume(folder.journal, HEADER) as journal:
        journal.append(ROWS[4])
        journal.append(ROWS[5])
    assert len(api.report(folder.path).rows) == 6


def test_rows_that_the_run_does_not_plan_are_told_and_not_judged(saved):
    failures = [row(trial(index), reached=0) for index in (4, 5)]
    folder = saved([*ROWS[:4], *failures], trials=4)
    judged = api.report(folder.path)
    assert [one.trial_id for one in judged.rows] == [trial(index).id for index in range(4)]
    assert judged.verdict.n == judged.verdict.planned == 4
    assert judged.verdict.success == 1.0
    assert "6 of 4" not in summary(judged)
    assert "2 rows of the journal (hurdles-one-004, hurdles-one-005)" in " ".join(
        summary(judged).split()
    )
    assert len(read_journal(folder.journal).rows) == 6, "what was run is kept"


def test_a_forged_trial_with_valid_sums_does_not_count(saved):
    stranger = replace(trial(0), scene="hurdles/else")
    folder = saved([*ROWS[:5], row(stranger)], ended=False)
    judged = api.report(folder.path)
    assert judged.verdict.n == 5
    assert judged.verdict.verdict == "INFRASTRUCTURE", "one trial of the plan is missing"
    folder.journal.unlink()
    with Journal.create(folder.journal, HEADER) as journal:
        for one in [*ROWS[:5], row(trial(5), seed=7)]:
            journal.append(one)
    with pytest.raises(StoreError, match="hurdles-one-005 is not of this run: its seed is 7"):
        api.report(folder.path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"suite": {"name": "quick"}}, "suite.nw-eval: field required"),
        ({"suite_digest": "ab" * 32}, "its suite is"),
        (
            {"scenes": {"a": SceneInfo(digest="d", task="t", trials=5)}},
            "numbers of trials of its scenes",
        ),
        (
            {
                "suite": SUITE.model_dump(by_alias=True, mode="json") | {"trials": 100_000},
                "scenes": {f"s{k}": SCENES["hurdles/one"] for k in range(20)},
            },
            "2000000 trials, over 1000000",
        ),
    ],
)
def test_a_run_json_that_contradicts_itself_is_one_line(saved, changes, words):
    folder = saved([], ended=False, **changes)
    with pytest.raises(StoreError, match=f"run.json of run is damaged: .*{words}") as caught:
        api.report(folder.path)
    assert "\n" not in str(caught.value)


def test_no_number_of_a_suite_in_run_json_is_no_number(saved):
    folder = saved(ROWS)
    info = json.loads(folder.run_json.read_text())
    info["suite"]["episode"]["duration"] = float("nan")
    folder.run_json.write_text(json.dumps(info))
    with pytest.raises(StoreError, match=r"run\.json is damaged"):
        api.report(folder.path)


@pytest.mark.parametrize(
    "read",
    [api.report, api.judge, api.read_rows, lambda run: api.compare([run, run])],
    ids=["report", "gate", "rows", "compare"],
)
def test_rows_that_contradict_themselves_are_refused_though_all_their_sums_fit(saved, read):
    rows = [row(trial(index)) for index in range(6)]
    free = {"waypoints_reached": 0, "waypoints_total": 0, "waypoint_times": ()}
    folder = saved([replace(rows[0], **free), *rows[1:]])
    assert api.verify(folder.path, offline=True).files.findings == (), "the sums fit"
    with pytest.raises(StoreError) as caught:
        read(folder.path)
    assert "the row of trial hurdles-one-000 contradicts itself" in caught.value.message
    assert "success 1.0 of a course without waypoints" in caught.value.message
    site = api.write_site([folder.path], folder.path.with_name("site"))
    assert site.exit_code != 0, "nothing of it is published"
