"""`nw-eval cache`: what it says, what it removes, and its exit codes."""

import re

import pytest
from cache_parts import conditions_of, jobs_of, row_of

from nw_eval.cli.process import end_of
from nw_eval.engine.cache import TrialStore

HERE = conditions_of()


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """Return what calls a verb; it returns exit code, output and errors."""
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "2")

    def run(*words):
        code = end_of(["cache", *words], description="").code
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


@pytest.fixture
def three(call, folder):
    """Keep three trials in the user's cache; return their folders."""
    assert call("info")[0] == 0
    store = TrialStore.of_user()
    for job in jobs_of(folder, trials=3):
        store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
    return [kept.path for kept in store]


def test_an_empty_cache_is_said_to_be_empty(call, tmp_path):
    code, out, _ = call("info")
    assert code == 0
    assert out.splitlines() == [
        f"folder     {tmp_path / 'cache' / 'trials'}",
        "size       0.0 MB, of at most 2.00 GB",
        "trials     0",
    ]


@pytest.mark.usefixtures("three")
def test_it_says_of_which_policies_it_has_trials(call):
    _, out, _ = call("info")
    assert "trials     3\n" in out
    assert re.search(r"last used  \d{4}-\d\d-\d\d \d\d:\d\d UTC or later", out)
    assert out.endswith("         3 p\n")
    assert "unusable" not in out


def test_what_cannot_be_used_is_counted_and_removed_once(call, three):
    (three[0] / "row.json").write_text("{}")
    assert "unusable   1; `nw-eval cache verify` removes" in call("info")[1]
    (three[1] / "log.mcap").write_text("foreign")
    said = "3 trials read, 2 damaged and removed; nothing was run\n"
    assert call("verify") == (4, said, "")
    assert call("verify") == (0, "1 trial read, none damaged; nothing was run\n", "")
    assert not three[0].exists()


@pytest.mark.usefixtures("three")
def test_it_is_pruned_to_a_size_and_to_nothing(call, tmp_path):
    where = tmp_path / "cache" / "trials"
    code, out, _ = call("prune")
    assert (code, out) == (0, f"0 trials removed (0.0 MB), 3 left (0.0 MB) in {where}\n")
    code, out, _ = call("prune", "--limit", "0")
    assert (code, out) == (0, f"3 trials removed (0.0 MB), 0 left (0.0 MB) in {where}\n")
    assert list(where.iterdir()) == []


@pytest.mark.parametrize("size", ["-1", "nan", "inf"])
def test_a_size_that_is_none_is_refused(call, size):
    code, _, err = call("prune", "--limit", size)
    assert (code, err) == (
        2,
        f"error: --limit {size} is not a size; give a size in GB, 0 or more\n",
    )


def test_a_folder_that_cannot_be_used_is_told_with_the_fix(call, tmp_path):
    (tmp_path / "cache").write_text("a file")
    code, _, err = call("info")
    assert code == 4
    assert "cannot write" in err
    assert "NW_EVAL_CACHE" in err
