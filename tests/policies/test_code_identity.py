"""A `python:` policy is what its files are: its digest says which, and a resume keeps to it."""

import pytest

from nw_base.errors import IncomparableError, PolicyError
from nw_eval import api
from nw_eval.cli.verbs.check import forecast_page
from nw_policies import bundle as code
from nw_policies import load_bundle

CARD = """\
nw-policy: 1
name: coded
robot: go1
adapter: python:identity_main:Policy
control: {action: joint_position_offset, scale: 0.25}
observations:
  body: {sensor: proprio, terms: [gravity]}
"""
SENSOR = "{sensor: 'identity_main:Sensor'}"
MAIN = """\
from identity_parts.level import LEVEL

class Policy:
    def __init__(self, bundle): pass
    def act(self, observation): return [LEVEL] * 12
"""
SUITE = """\
nw-eval: 1
name: coded
robot: go1
policy: POLICY
trials: 1
seed: 5
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "coded"
    (made / "identity_parts").mkdir(parents=True)
    (made / "policy.yaml").write_text(CARD)
    (made / "identity_main.py").write_text(MAIN)
    (made / "identity_parts" / "level.py").write_text("LEVEL = 0.0\n")
    return made


def test_every_python_file_below_the_card_counts_and_nothing_else_does(folder):
    digests = [load_bundle(folder).digest]
    (folder / "notes.txt").write_text("x")
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "identity_main.pyc").write_bytes(b"x")
    assert load_bundle(folder).digest == digests[0]
    level = folder / "identity_parts" / "level.py"
    level.write_text("LEVEL = 0.1\n")
    digests.append(load_bundle(folder).digest)
    level.rename(level.with_name("height.py"))
    digests.append(load_bundle(folder).digest)
    assert len(set(digests)) == 3


def test_code_counts_beside_weights_too(folder):
    (folder / "w.bin").write_bytes(b"weights")
    sha256 = "f" * 64
    card = CARD + f"checkpoint: {{file: w.bin, sha256: {sha256}}}\n"
    (folder / "policy.yaml").write_text(card)
    before = load_bundle(folder, checkpoint=folder / "w.bin")
    (folder / "identity_main.py").write_text(MAIN + "# other\n")
    after = load_bundle(folder, checkpoint=folder / "w.bin")
    assert before.checkpoint_sha256 == after.checkpoint_sha256
    assert before.digest != after.digest


def test_a_sensors_code_counts_too(folder):
    card = CARD.replace("python:identity_main:Policy", "zero")
    (folder / "policy.yaml").write_text(card.replace("{sensor: proprio, terms: [gravity]}", SENSOR))
    before = load_bundle(folder)
    (folder / "identity_main.py").write_text(MAIN + "# other\n")
    assert load_bundle(folder).digest != before.digest
    assert before.origin == f"code {before.code_sha256[:16]}"


def test_links_are_not_followed_out_of_the_folder(folder, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "more.py").write_text("A = 1\n")
    (folder / "more.py").symlink_to(outside / "more.py")
    (folder / "parts").symlink_to(outside)
    before = load_bundle(folder).digest
    (outside / "more.py").write_text("A = 2\n")
    assert load_bundle(folder).digest == before
    (folder / "parts").unlink()
    (folder / "parts").symlink_to(folder / "identity_parts")
    assert load_bundle(folder).digest != before


def test_a_folder_with_too_much_code_is_refused(folder, monkeypatch):
    monkeypatch.setattr(code, "CODE_LIMIT", 100)
    with pytest.raises(PolicyError, match="into a folder of their own"):
        load_bundle(folder)


def test_a_check_names_the_code_or_says_that_there_is_no_checkpoint(folder, tmp_path):
    (tmp_path / "suite.yaml").write_text(SUITE.replace("POLICY", "stand"))
    suite = tmp_path / "suite.yaml"
    assert "stand  (zero, no checkpoint)" in forecast_page(api.check(suite))
    said = forecast_page(api.check(suite, policy=str(folder), allow_code=True))
    assert f"Policy, code {load_bundle(folder).checkpoint_sha256[:16]})" in said
    assert "code outside the card's folder is not part of it" in said


@pytest.mark.nightly
def test_a_run_of_other_code_is_not_resumed(folder, tmp_path):
    (tmp_path / "suite.yaml").write_text(SUITE.replace("POLICY", str(folder)))
    out = tmp_path / "run"
    report = api.run(tmp_path / "suite.yaml", out=out, workers=1, allow_code=True)
    assert [row.status for row in report.rows] == ["ok"], report.rows[0].error_text
    assert report.rows[0].checkpoint_digest == load_bundle(folder).checkpoint_sha256
    (folder / "identity_parts" / "level.py").write_text("LEVEL = 0.5\n")
    with pytest.raises(IncomparableError, match=r"policy \(.*\) changed"):
        api.run(None, resume=out, workers=1, allow_code=True)
