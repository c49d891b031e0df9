"""Real parts of a run: run apart, cut short, resumed, and merged to its rows and logs."""

from pathlib import Path

import pytest
from command_line import ends

from nw_base.errors import IncomparableError
from nw_eval import api
from nw_gate.results.provenance import read_run_info

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 2
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room, hurdles/three_low]
record: none
gate: {success_rate: 0.9}
"""


def run(name, shard=None, **changes):
    return api.run("tiny.yaml", out=Path(name), shard=shard, in_process=True, **changes)


def cut(folder):
    """Leave of a run what a kill after its first trial leaves."""
    lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "journal.jsonl").write_bytes(b"".join(lines[:2]))
    (folder / "trials.parquet").unlink()


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A folder with a run, and with the same in three parts."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("tiny.yaml").write_text(SUITE)
        run("whole")
        for index in (1, 2, 3):
            run(f"parts/{index}", f"{index}/3")
    return folder


def logs_of(folder):
    return {log.relative_to(folder): log.read_bytes() for log in folder.rglob("*.mcap")}


def test_real_parts_merge_to_the_rows_and_logs_of_the_run(project, monkeypatch):
    monkeypatch.chdir(project)
    whole = api.report("whole")
    merged = api.merge(sorted(Path("parts").iterdir()), out="merged")
    assert merged.info.rows_digest == whole.info.rows_digest
    assert merged.verdict == whole.verdict
    assert len(logs_of(Path("merged"))) == 4
    assert logs_of(Path("merged")) == logs_of(Path("whole"))
    assert Path("merged/foxglove.json").read_bytes() == Path("whole/foxglove.json").read_bytes()
    # It is a run like any other: gated, read, and gone on with.
    assert api.judge("merged").verdict == whole.verdict
    assert len(api.read_rows("merged")) == 4
    more = api.run(None, resume=Path("merged"), trials=3, in_process=True)
    assert (more.info.shard, len(more.rows)) == (None, 6)


def test_a_part_that_was_cut_short_continues_as_the_part_that_it_was(
    project, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(SUITE)
    first = run("first", "1/2")
    assert first.folder.name == "first"
    cut(Path("first"))
    with pytest.raises(IncomparableError, match="as --shard 2/2: it was started as part 1 of 2"):
        api.run(None, resume=Path("first"), shard="2/2")
    again = api.run(None, resume=Path("first"), in_process=True)
    assert again.info.rows_digest == first.info.rows_digest
    assert str(read_run_info(Path("first/run.json")).shard) == "part 1 of 2"
    with pytest.raises(IncomparableError, match="as --shard 1/2: it was started as all of its tri"):
        api.run(None, resume=project / "whole", shard="1/2")

    assert ends("gate", "first") == 2
    assert "put all parts together with `nw-eval merge RUN..." in capsys.readouterr().err


def test_a_part_has_its_place_in_its_name_and_in_what_is_foreseen(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(SUITE)
    judged = api.run("tiny.yaml", shard="2/4", in_process=True)
    assert judged.folder.name.endswith("-2of4")
    foreseen = api.check("tiny.yaml", shard="2/4")
    assert (foreseen.trials, str(foreseen.shard)) == (1, "part 2 of 4")
    planned = api.plan_shards("tiny.yaml", 3)
    assert [part.trials for part in planned.parts] == [2, 1, 1]
    assert planned.trials == api.check("tiny.yaml").trials == 4


def test_the_matrix_is_one_line_that_a_runner_reads(project, monkeypatch, capsys):
    monkeypatch.chdir(project)
    assert ends("plan", "tiny.yaml", "--shards", "3", "--json") == 0
    shown = capsys.readouterr().out
    assert shown == (
        '{"include": [{"suite": "tiny.yaml", "shard": "1/3", "index": 1, "count": 3, "trials": 2}, '
        '{"suite": "tiny.yaml", "shard": "2/3", "index": 2, "count": 3, "trials": 1}, '
        '{"suite": "tiny.yaml", "shard": "3/3", "index": 3, "count": 3, "trials": 1}]}\n'
    )
    for words, why in (
        (["--trials", "3"], "--trials without --shards"),
        (["--shards", "2", "--out", "x.png"], "--out with --shards"),
        (["--shards", "5"], "--shards 5: the run has 4 trials; give a number from 1 to 4"),
    ):
        assert ends("plan", "tiny.yaml", *words) == 2
        assert why in capsys.readouterr().err


@pytest.mark.nightly
def test_parts_of_smoke_by_the_command_line_merge_to_smoke(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for out, words in {
        "whole": [],
        **{f"parts/{index}": ["--shard", f"{index}/3"] for index in (1, 2, 3)},
    }.items():
        assert ends("run", "smoke", "--out", out, *words) == 0
    assert ends("merge", *map(str, Path("parts").iterdir()), "--out", "merged") == 0
    assert "RAN" in capsys.readouterr().out
    digests = {read_run_info(Path(name, "run.json")).rows_digest for name in ("whole", "merged")}
    assert len(digests) == 1


def test_the_one_part_of_a_run_is_judged_as_the_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(SUITE)
    only = run("only", "1/1")
    assert (only.verdict.verdict, only.exit_code) == ("REGRESSED", 1)
    assert api.merge(["only"], out="merged").verdict == only.verdict
