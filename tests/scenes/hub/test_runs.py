"""A run of what lies on a hub: it fetches what is missing, and run.json says what it had."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys

import pytest
from hub_server import WRITER

from nw_base.errors import SuiteError
from nw_eval import api
from nw_eval.api.baselines import card_reference
from nw_eval.cli import main
from nw_gate.results.provenance import read_run_info
from nw_policies import load_bundle

SUITE = """\
nw-eval: 1
name: far
robot: go1
policy: hub:lab/still
trials: 1
seed: 7
episode: {duration: 0.2}
scenes:
  - hub:lab/corridor
record: none
"""
PLACE = "hub:lab/corridor"


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "far.yaml"
    path.write_text(SUITE)
    return path


def nw_eval(capsys, *arguments):
    """Type a command; return its exit code, standard output and standard error."""
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return int(left.value.code or 0), *capsys.readouterr()


def test_a_run_fetches_what_it_names_and_writes_down_what_that_was(
    hub, place, policy, suite, tmp_path
):
    ended = api.run(suite, out=tmp_path / "run", workers=1)
    assert ended.exit_code == 0
    info = read_run_info(tmp_path / "run" / "run.json")
    scene, card = info.scenes["far/corridor"].fetched, info.policy.fetched
    assert scene is not None
    assert card is not None
    assert (scene.reference, card.reference) == ("hub:lab/corridor", "hub:lab/still")
    assert (scene.revision, card.revision) == (
        place.revisions["main"], policy.revisions["main"]
    )  # fmt: skip
    assert set(scene.files) == {"scene.yaml", "collision.yaml", "notes/large.bin"}
    assert all(len(digest) == 64 for digest in (*scene.files.values(), *card.files.values()))
    report = (tmp_path / "run" / "report.md").read_text()
    assert re.search(
        f"hub:lab/still `?{card.revision[:12]};?`? hub:lab/corridor `?{scene.revision[:12]}", report
    )

    # The network goes, both repositories have moved on before, and the same trial is the same.
    place.commit({"collision.yaml": b"boxes: []\n"})
    hub.close()
    again = api.run(suite, out=tmp_path / "again", workers=1)
    (one,), (other,) = (each.rows for each in (ended, again))
    assert (one.state_digest, one.trial_id) == (other.state_digest, other.trial_id)
    assert read_run_info(tmp_path / "again" / "run.json").scenes == info.scenes


def test_what_lay_on_the_machine_was_not_fetched(suite, tmp_path):
    suite.write_text(SUITE.replace(PLACE, "flat/carpet_room").replace("hub:lab/still", "stand"))
    api.run(suite, out=tmp_path / "run", workers=1)
    saved = json.loads((tmp_path / "run" / "run.json").read_text())
    assert saved["policy"]["fetched"] is None
    assert {scene["fetched"] for scene in saved["scenes"].values()} == {None}


@pytest.mark.usefixtures("policy")
def test_a_place_that_is_not_there_is_a_fault_at_its_line_of_the_suite(suite):
    with pytest.raises(SuiteError, match=r"far\.yaml:9:5: hub:lab/corridor: .* has no data set"):
        api.check(suite)


def test_the_command_says_where_it_lies_and_goes_on_without_a_network(hub, place, capsys):
    code, out, err = nw_eval(capsys, "scenes", "fetch", "hub:lab/corridor")
    commit = place.revisions["main"]
    assert code == 0
    assert f"hub:lab/corridor is revision {commit[:12]}, fetched 2" in out
    assert "3 files, 2 MB" in out
    assert out.splitlines()[1].endswith(f"/hub/scene/lab/corridor/{commit}/corridor")
    assert f"fetching hub:lab/corridor, revision {commit[:12]}: 3 files, 2 MB" in err
    hub.close()
    code, out, err = nw_eval(capsys, "scenes", "show", "hub:lab/corridor")
    assert (code, out.splitlines()[0].split()) == (0, ["name", "far/corridor"])
    assert err.splitlines() == [err.strip()]
    assert f"hub:lab/corridor is revision {commit[:12]}" in err
    code, out, err = nw_eval(capsys, "scenes", "fetch", "hub:lab/corridor")
    assert (code, out) == (4, "")
    assert "cannot reach" in err.splitlines()[-1]


@pytest.mark.usefixtures("place", "policy")
def test_a_policy_is_fetched_ahead_shown_and_tried_in_a_place_from_afar(capsys):
    code, out, _ = nw_eval(capsys, "policies", "fetch", "hub:lab/still")
    assert code == 0
    assert "hub:lab/still is revision" in out
    assert nw_eval(capsys, "policies", "show", "hub:lab/still")[0] == 0
    # It is tried by a process that has no network.
    code, out, err = nw_eval(
        capsys, "policies", "check", "hub:lab/still", "--scene", "triangles:hub:lab/corridor"
    )
    assert "far/corridor" in out + err or code in {0, 2}
    assert "no built-in scene" not in err


@pytest.mark.nightly
@pytest.mark.usefixtures("place")
def test_a_terminal_shows_a_bar_with_bytes():
    child, terminal = pty.openpty()
    ended = subprocess.Popen(
        [sys.executable, "-c", "from nw_eval.cli import main; main()", "scenes", "fetch", PLACE],
        stdout=subprocess.PIPE,
        stderr=terminal,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
    )
    output, _ = ended.communicate(timeout=60)
    os.close(terminal)
    shown = os.read(child, 100_000).decode(errors="replace")
    os.close(child)
    assert ended.returncode == 0
    assert b"hub:lab/corridor is revision" in output
    assert "notes/large.bin" in shown
    assert "/2.0 MB" in shown


def test_a_token_for_writing_is_no_part_of_any_line(monkeypatch, capsys):
    monkeypatch.setenv("HF_TOKEN", WRITER)
    for kind in ("scenes", "policies"):
        code, out, err = nw_eval(capsys, kind, "fetch", "hub:lab/nothing")
        assert code == 2
        assert WRITER not in out + err
        assert "that the token may read it" in err


def test_a_baseline_names_the_revision_of_its_policy_for_other_machines(policy):
    bundle = load_bundle("hub:lab/still@main")
    reference = card_reference(bundle.reference)
    assert reference == f"hub:lab/still@{policy.revisions['main']}"
    assert load_bundle(reference).digest == bundle.digest
