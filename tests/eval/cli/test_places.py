"""Where a run is to write is checked before its first trial."""

import os
from contextlib import suppress

import pytest
from command_line import ends

from nw_base.errors import NwEvalError, UsageError
from nw_eval import api
from nw_eval.api.ledgers import check_ledger
from nw_gate.results.evidence import log_sha256
from nw_gate.results.run_folder import open_run_folder

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 1
seed: 7
episode: {duration: 0.1}
scenes: [flat/carpet_room]
record: none
"""


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A folder with what nothing can be written to."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(SUITE)
    (tmp_path / "file").write_text("hello\n")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to("one")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ("--out", "file"),
        ("--out", "file/below"),
        ("--out", "one"),
        ("--ledger", "file"),
        ("--ledger", "folder"),
        ("--ledger", "file/below"),
        ("--ledger", "one"),
        ("--ledger", "/proc/none/ledger"),
        ("--ledger", "pipe"),
        ("--ledger", "/dev/full"),
        ("--ledger", "/dev/null"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_anything_runs(
    places, arguments, capsys, monkeypatch
):
    monkeypatch.setattr(api, "record_verdict", lambda *_: pytest.fail("it ran"))
    before = sorted(places.rglob("*"))
    line = ["run", "tiny.yaml", "--in-process", *arguments]
    assert ends(*line) == 2
    said = capsys.readouterr().err
    assert arguments[1].partition("/")[0] in said
    assert "disk space" not in said
    assert sorted(places.rglob("*")) == before


def test_a_ledger_that_can_be_written_is_left_as_it_is(places):
    for name in ("new", "folder/new", "absent/new"):
        check_ledger(name)
    assert not (places / "new").exists()
    assert not (places / "absent").exists()


FOLDERS = ("mcap", "cached", "bank", "baseline", "mcap/flat", "baseline/mcap", "cached/a/b")


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_of_a_run_that_is_a_link_is_not_followed(places, name):
    run = places / "run"
    run.mkdir()
    (run / "run.json").write_text("{}")
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / name).symlink_to(places / "folder")
    with pytest.raises(UsageError, match=f"{name} is a link"):
        open_run_folder(run)
    with pytest.raises(UsageError, match=f"{name} is a link"):
        api.run("tiny.yaml", out=run, in_process=True)
    assert not any((places / "folder").iterdir())


FILES = ("run.json", "journal.jsonl", "trials.parquet", "digests.json", "cause.json", "LOG")


def test_a_pipe_in_place_of_a_file_of_a_run_is_not_waited_for(places):
    made = api.run("tiny.yaml", out=places / "run", in_process=True).folder
    for name in FILES:
        path = next(made.rglob("*.mcap")) if name == "LOG" else made / name
        kept = path.read_bytes() if path.exists() else None
        path.unlink(missing_ok=True)
        os.mkfifo(path)
        for read in (api.verify, api.judge, api.read_rows, api.report):
            with suppress(NwEvalError):
                read(made)
        if name in {"journal.jsonl", "LOG"}:
            assert api.verify(made).exit_code, "what is not a file is not as it was"
        path.unlink()
        if kept is not None:
            path.write_bytes(kept)
    os.mkfifo(places / "log")
    assert log_sha256(places / "log") == ""
