"""A policy that takes too much memory costs its trial, in which it is said how much that was."""

import re
from pathlib import Path

import pytest

LIMIT = "700MB"  # A worker holds some 200 MB by itself.
HOARD = "hoard = [bytearray(10**7) for _ in range(100)]; time.sleep(60)"
HOARDS = f"import time; {HOARD}"
FATHERS = f"subprocess.run([sys.executable, '-c', {HOARDS!r}], start_new_session=True)"
HOARDS_ONCE = f"""
            import time
            if not (self.folder / "hoarded").exists():
                {HOARD}
"""


@pytest.mark.parametrize(
    ("deed", "by"),
    [
        (HOARDS, "policy"),
        pytest.param(HOARDS, "sensor", marks=pytest.mark.nightly),
        (FATHERS, "sensor"),
    ],
    ids=["the policy", "its sensor", "the sensor's child"],
)
def test_a_trial_that_holds_too_much_is_crashed_and_says_how_much_it_held(tiny_run, deed, by):
    run = tiny_run("hoarder", deed=deed, by=by, trials=1, memory_limit=LIMIT)
    with run.pool() as pool:
        pool.submit(run.jobs)
        [ended] = [each for each in pool.finished() if each is not None]
    assert (ended.result.status, ended.result.error_type) == ("error", "crashed")
    text = r"the worker and its children held (.+) (MB|GB), --memory-limit is 700 MB"
    held, unit = re.fullmatch(text, ended.result.error_text).groups()
    assert 0.7 < float(held) * {"MB": 0.001, "GB": 1.0}[unit] < 1.3


def test_the_run_goes_on_with_a_fresh_worker_and_the_trial_runs_once_more(tiny_run):
    run = tiny_run("hoarder", deed=HOARDS_ONCE, trials=3, memory_limit=LIMIT)
    mark = Path(run.jobs[0].policy).with_name("hoarded")
    run.ears.heard = lambda text: mark.touch() if "crashed" in text else None
    outcome = run.go(workers=1)
    assert [row.status for row in outcome.rows] == ["ok"] * 3
    assert sorted(row.attempt for row in outcome.rows) == [1, 1, 2]
    [said] = [text for text in run.ears.messages if "--memory-limit is 700 MB" in text]
    assert "crashed: the worker and its children held" in said
