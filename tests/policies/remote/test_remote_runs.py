"""A policy on a server scores what it scores here, row for row, through the whole runner."""

import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import IncomparableError, PolicyError
from nw_eval import api
from nw_eval.engine.plan import plan_jobs
from nw_gate.results.provenance import read_run_info
from nw_gate.results.run_folder import RunFolder, open_run_folder
from nw_policies import load_bundle
from nw_policies.opening import ZeroPolicy
from nw_policies.serve import serving
from nw_sim.rollout.job import policy_fault
from nw_sim.rollout.trial import run_trial

SUITE = """\
nw-eval: 1
name: remote
robot: go1
policy: go1-parkour
trials: 2
seed: 5
episode: {duration: 4.0}
scenes: [hurdles/three_low]
record: none
"""
SHORT = """\
nw-eval: 1
name: short
robot: go1
policy: stand
trials: 1
seed: 5
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""
STANDING = """\
nw-policy: 1
name: NAME
robot: go1
adapter: ADAPTER
control: {action: joint_position_offset, scale: 0.25}
observations:
  body: {sensor: proprio, terms: TERMS}
"""
TERMS = "[joint_pos, joint_vel, gravity]"
SAME = (
    "trial_id",
    "outcome",
    "success",
    "waypoints_reached",
    "steps",
    "state_digest",
    "action_digest",
)


def remote_card(local: Path, url: str, folder: Path, port_digest: str = "") -> Path:
    """Return the card of a local bundle with its checkpoint on a server."""
    lines = local.read_text().splitlines()
    start = lines.index("checkpoint:")
    text = "\n".join([*lines[:start], *lines[start + 3 :]])
    text = text.replace("adapter: onnx", f"adapter: remote\noptions: {{url: {url}{port_digest}}}")
    path = folder / "policy.yaml"
    path.write_text(text + "\n")
    return path


def test_a_remote_policy_gives_the_rows_of_the_local_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "remote.yaml").write_text(SUITE)
    local = load_bundle("go1-parkour")
    with serving(local) as address:
        card = remote_card(local.card_path, address.url, tmp_path)
        there = api.run("remote.yaml", policy=str(card), workers=1, out=tmp_path / "there")
    here = api.run("remote.yaml", workers=1, out=tmp_path / "here")
    assert [r.status for r in here.rows] == ["ok", "ok"]
    for ours, theirs in zip(here.rows, there.rows, strict=True):
        assert {k: getattr(ours, k) for k in SAME} == {k: getattr(theirs, k) for k in SAME}


def test_where_a_policy_is_served_is_no_part_of_its_digest(tmp_path):
    local = load_bundle("go1-parkour").card_path
    digests = set()
    for index, (url, more) in enumerate(
        [("ws://a:1", ""), ("ws://b:2", ", timeout: 9"), ("ws://a:1", f", digest: {'0' * 64}")]
    ):
        folder = tmp_path / str(index)
        folder.mkdir()
        digests.add(load_bundle(remote_card(local, url, folder, more)).digest)
    assert len(digests) == 2


def standing(folder: Path, name: str, **replaced: str) -> Path:
    """Return a folder whose card stands still and sees a body."""
    made = folder / name
    made.mkdir()
    text = STANDING.replace("NAME", name)
    for key, value in replaced.items():
        text = text.replace(key.upper(), value)
    (made / "policy.yaml").write_text(text)
    return made


def test_a_run_keeps_to_what_its_server_said_that_it_serves(tmp_path):
    (tmp_path / "suite.yaml").write_text(SHORT)
    one = load_bundle(standing(tmp_path, "one", adapter="zero", terms=TERMS))
    other = load_bundle(standing(tmp_path, "other", adapter="zero", terms=TERMS))
    with serving(one) as address:
        adapter = f"remote\noptions: {{url: '{address.url}'}}"
        card = str(standing(tmp_path, "client", adapter=adapter, terms=TERMS))
        made = api.plan(tmp_path / "suite.yaml", policy=card)
        run = api.run(tmp_path / "suite.yaml", policy=card, workers=1, out=tmp_path / "run")
        again = api.run(None, resume=tmp_path / "run", workers=1)
    assert [(row.status, row.checkpoint_digest) for row in run.rows] == [("ok", one.digest)]
    assert again.rows == run.rows
    assert read_run_info(tmp_path / "run" / "run.json").policy.checkpoint_digest == one.digest
    (job,) = plan_jobs(made, open_run_folder(tmp_path / "run"))
    port = int(address.url.rsplit(":", 1)[1])
    with serving(other, port=port):
        with pytest.raises(IncomparableError, match=r"policy \(.*\) changed"):
            api.run(None, resume=tmp_path / "run", workers=1)
        result = run_trial(job)
    assert (result.status, result.error_type) == ("error", "crashed")
    assert f"serves {other.digest[:12]}, the trial was planned with {one.digest[:12]}" in (
        result.error_text
    )


def test_what_a_served_policy_does_is_its_own_and_what_its_server_does_is_not(
    tmp_path, monkeypatch
):
    (tmp_path / "suite.yaml").write_text(SHORT)
    local = load_bundle(standing(tmp_path, "local", adapter="zero", terms=TERMS))
    results, goes_on = {}, threading.Event()
    with serving(local) as address:
        jobs = {}
        for seconds in (0.3, 60.0):  # Little time where no answer comes, and enough where one does.
            adapter = f"remote\noptions: {{url: '{address.url}', timeout: {seconds}}}"
            card = standing(tmp_path, f"client-{seconds}", adapter=adapter, terms=TERMS)
            while seconds not in jobs:
                with suppress(PolicyError):  # A busy machine may take longer to answer, here too.
                    plan = api.plan(tmp_path / "suite.yaml", policy=str(card))
                    (job,) = plan_jobs(plan, RunFolder(path=tmp_path / "run"))
                    jobs[seconds] = replace(job, mcap=None)
        acts = {
            "nan": (60.0, lambda: np.full(12, np.nan)),
            "raises": (60.0, lambda: 1 / 0),
            "sleeps": (0.3, goes_on.wait),
        }
        for name, (seconds, act) in acts.items():
            monkeypatch.setattr(ZeroPolicy, "act", lambda _self, _seen, act=act: act())
            results[name] = run_trial(jobs[seconds])
        goes_on.set()
    results["gone"] = run_trial(jobs[60.0])
    assert {result.status for result in results.values()} == {"error"}
    assert {name: policy_fault(result) for name, result in results.items()} == {
        "nan": "action",
        "raises": "exception",
        "sleeps": None,
        "gone": None,
    }
    assert "ZeroDivisionError" in results["raises"].error_text
    assert "no answer from" in results["sleeps"].error_text
    assert "no policy server at" in results["gone"].error_text


def test_a_card_of_other_sizes_than_the_served_one_fails_before_the_run(tmp_path):
    (tmp_path / "suite.yaml").write_text(SHORT)
    short = TERMS.replace(", gravity", "")
    served = standing(tmp_path, "served", adapter="zero", terms=short)
    with api.serve_policy(str(served), port=0) as served:
        adapter = f"remote\noptions: {{url: '{served.url}'}}"
        card = standing(tmp_path, "client", adapter=adapter, terms=TERMS)
        with pytest.raises(PolicyError) as caught:
            api.check(tmp_path / "suite.yaml", policy=str(card))
    assert "`body` is 27 numbers; on the served card it is 24;" in str(caught.value)
    assert "the card makes `body` 27 = 12 + 12 + 3; copy" in str(caught.value)


@pytest.mark.parametrize("missing", ["msgpack", "websockets"])
def test_without_the_extra_the_error_says_what_to_install(missing):
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from nw_base.errors import PrerequisiteError\n"
        "try:\n    import nw_policies.remote\n"
        "except PrerequisiteError as error:\n    print(error)\n"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert "pip install 'nw-eval[remote]'" in shown
