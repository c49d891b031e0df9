import hashlib
import json

import pytest

from nw_base.errors import PolicyError
from nw_base.files.shipped import available
from nw_policies import bundle as bundles
from nw_policies import load_bundle

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: onnx
checkpoint: {file: %s, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations: {obs: {sensor: proprio, layout: parkour53}}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "weights.onnx").write_bytes(b"weights")
    write_card(tmp_path)
    return tmp_path


def write_card(folder, file="weights.onnx", sha256=None):
    digest = sha256 or hashlib.sha256(b"weights").hexdigest()
    (folder / "policy.yaml").write_text(CARD % (file, digest))


@pytest.mark.parametrize("name", sorted(available("policies")))
def test_every_shipped_bundle_is_valid(name):
    bundle = load_bundle(name)
    assert bundle.name == name
    assert (bundle.folder / "README.md").is_file()
    if bundle.checkpoint is not None:
        assert bundle.checkpoint.stat().st_size < 4_000_000


def test_a_bundle_is_found_by_folder_and_by_card(folder):
    assert load_bundle(folder).digest == load_bundle(folder / "policy.yaml").digest


def test_an_example_card_is_found_under_the_shipped_policies(tmp_path):
    (tmp_path / "w.onnx").write_bytes(b"any")
    bundle = load_bundle("examples/playground-go1", checkpoint=tmp_path / "w.onnx")
    assert bundle.name == "playground-go1"


def test_an_unknown_name_is_answered_with_the_nearest_one():
    with pytest.raises(PolicyError, match="did you mean 'go1-parkour'"):
        load_bundle("go1-parkur")


def test_weights_in_place_of_a_card_are_answered_with_how_to_give_them(folder):
    with pytest.raises(PolicyError, match="--checkpoint"):
        load_bundle(folder / "weights.onnx")


def test_a_folder_without_a_card_is_an_error(tmp_path):
    with pytest.raises(PolicyError, match=r"has no policy\.yaml"):
        load_bundle(tmp_path)


def test_a_missing_checkpoint_names_the_file_and_the_fix(folder):
    (folder / "weights.onnx").unlink()
    with pytest.raises(
        PolicyError, match=r"weights\.onnx: the checkpoint is missing.*--checkpoint"
    ):
        load_bundle(folder)


def test_a_checkpoint_with_another_digest_is_refused(folder):
    (folder / "weights.onnx").write_bytes(b"tampered")
    with pytest.raises(PolicyError, match="that on the card is") as caught:
        load_bundle(folder)
    assert hashlib.sha256(b"tampered").hexdigest() in str(caught.value)


def test_a_checkpoint_that_changes_after_the_check_is_not_loaded(folder):
    bundle = load_bundle(folder)
    (folder / "weights.onnx").write_bytes(b"tampered")
    with pytest.raises(PolicyError, match="changed while it was in use"):
        bundle.read_checkpoint()


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "weights.onnx"
    outside.write_bytes(b"weights")
    (folder / "link.onnx").symlink_to(outside)
    write_card(folder, file="link.onnx")
    with pytest.raises(
        PolicyError, match=r"is outside the card's folder: a link on its way leads to .*outside"
    ):
        load_bundle(folder)


def test_a_policy_or_a_checkpoint_that_no_file_can_be_called_is_refused(folder):
    for name in ("x" * 300, "a\0b"):
        with pytest.raises(PolicyError, match="unknown policy"):
            load_bundle(name)
    write_card(folder, file="x" * 300)
    with pytest.raises(PolicyError, match="longer than a file system allows"):
        load_bundle(folder)


def test_weights_given_by_hand_need_not_have_the_cards_digest_but_are_recorded(folder, tmp_path):
    other = tmp_path / "candidate.onnx"
    other.write_bytes(b"candidate")
    bundle = load_bundle(folder, checkpoint=other)
    assert bundle.checkpoint_sha256 == hashlib.sha256(b"candidate").hexdigest()
    assert bundle.digest != load_bundle(folder).digest


def test_a_checkpoint_over_the_size_limit_is_not_read(folder, monkeypatch):
    monkeypatch.setattr(bundles, "SIZE_LIMIT", 3)
    with pytest.raises(PolicyError, match="over the limit"):
        load_bundle(folder)


def test_a_card_without_digest_takes_the_file_that_lies_there_and_records_which(folder):
    text = (folder / "policy.yaml").read_text()
    (folder / "policy.yaml").write_text(text.replace(", sha256: ", "}  # "))
    bundle = load_bundle(folder)
    assert bundle.checkpoint_sha256 == hashlib.sha256(b"weights").hexdigest()
    file = next(path for path in folder.iterdir() if path.read_bytes() == b"weights")
    file.write_bytes(b"others")
    with pytest.raises(PolicyError, match="changed while it was in use"):
        bundle.read_checkpoint()
    assert load_bundle(folder).digest != bundle.digest


def test_a_policy_without_weights_takes_none(folder):
    with pytest.raises(PolicyError, match="has no weights"):
        load_bundle("stand", checkpoint=folder / "weights.onnx")


def test_the_digest_changes_with_the_card_but_not_with_its_title(folder):
    before = load_bundle(folder).digest
    card = folder / "policy.yaml"
    card.write_text(card.read_text() + "title: hello\n")
    assert load_bundle(folder).digest == before
    card.write_text(card.read_text().replace("scale: 0.25", "scale: 0.5"))
    assert load_bundle(folder).digest != before


def test_the_digest_changes_with_the_order_in_which_one_input_takes_the_observations(folder):
    card = folder / "policy.yaml"
    one, two = (
        "body: {sensor: proprio, terms: [gravity]}",
        "legs: {sensor: proprio, terms: [joint_pos]}",
    )
    found: list[bundles.Bundle] = []
    for first, second in ((one, two), (two, one)):
        observations = f"observations: {{{first}, {second}}}\n"
        card.write_text(CARD.partition("observations")[0] % ("w", "w") + observations)
        text = card.read_text().replace("file: w, sha256: w", "file: weights.onnx")
        card.write_text(text)
        found.append(load_bundle(folder))
    assert [list(each.card.observations) for each in found] == [["body", "legs"], ["legs", "body"]]
    assert found[0].digest != found[1].digest
    assert found[0].computes != found[1].computes
    # One that is in the order of the alphabet has the digest that it had before orders counted.
    fields = found[0]._meaning()
    before = json.dumps([fields, found[0].checkpoint_digest], sort_keys=True)
    assert found[0].digest == hashlib.sha256(before.encode()).hexdigest()


def test_the_digest_changes_with_the_order_of_patterns_that_mean_the_same_joint(folder):
    card, text = folder / "policy.yaml", (folder / "policy.yaml").read_text()
    digests: list[str] = []
    for kp in ("'*_hip': 9, 'FL_*': 20", "'FL_*': 20, '*_hip': 9"):
        card.write_text(text.replace("scale: 0.25", f"scale: 0.25, kp: {{{kp}}}"))
        digests.append(load_bundle(folder).digest)
    assert digests[0] != digests[1]


def test_a_path_that_leads_nowhere_is_told_from_a_misspelt_name():
    for path in ("./mine", "robots/mine", "mine.yaml"):
        with pytest.raises(PolicyError, match=f"'{path}': there is no such folder or card; known:"):
            load_bundle(path)
    with pytest.raises(PolicyError, match="no policy, folder or card has that name; did you mean"):
        load_bundle("go1-parkor")
