"""Networks that feed a policy, as a card says them: what cannot be is said with its place."""

import hashlib
import re

import pytest

from nw_base.errors import PolicyError
from nw_policies import load_bundle
from nw_policies.cards import load_card

BODY, ENCODER = b"the policy", b"what feeds it"
DIGESTS = {name: hashlib.sha256(data).hexdigest() for name, data in (("B", BODY), ("E", ENCODER))}

CARD = """\
nw-policy: 1
name: fed
robot: go1
adapter: torchscript
checkpoint: {file: body.pt, sha256: B}
control: {action: joint_position_offset, scale: 0.25, rate: 25}
observations:
  body: {sensor: proprio, terms: [joint_pos]}
  past: {sensor: proprio, terms: [joint_pos], history: 5}
networks:
  adaptation:
    adapter: onnx
    checkpoint: {file: encoder.onnx, sha256: E}
    inputs: {obs_history: [past]}
    outputs: {latent: {select: ["0:8"]}, velocity: {output: vel, scale: 2}}
    rate: 5
inputs: [body, adaptation.latent, adaptation.velocity]
"""


def written(folder, text=CARD):
    for name, digest in DIGESTS.items():
        text = re.sub(rf"sha256: {name}\b", f"sha256: {digest}", text)
    (folder / "body.pt").write_bytes(BODY)
    (folder / "encoder.onnx").write_bytes(ENCODER)
    (folder / "policy.yaml").write_text(text)
    return folder / "policy.yaml"


def test_a_card_says_what_feeds_its_policy(tmp_path):
    card = load_card(written(tmp_path))
    (network,) = card.networks.values()
    assert network.inputs == {"obs_history": ["past"]}
    assert list(network.given_as("adaptation")) == ["adaptation.latent", "adaptation.velocity"]
    assert network.rate == 5


ANOTHER = """\
  {name}:
    adapter: onnx
    checkpoint: {{file: encoder.onnx, sha256: E}}
    inputs: [{takes}]
inputs: [body, adaptation.latent, adaptation.velocity{uses}]
"""


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("[past]}", "[psat]}", r":14:28: .*inputs: unknown .* 'psat'; did you mean 'past'\?"),
        (
            "adaptation.latent, ",
            "adaptation.latnet, ",
            r":17:16: inputs: unknown observation or network 'adaptation.latnet'; did you mean 'ad",
        ),
        (
            "[body, adaptation.latent, adaptation.velocity]",
            "[body, adaptation]",
            r":17:16: inputs: network 'adaptation' gives adaptation\.latent, adaptation\.velocity",
        ),
        (
            "adaptation.latent, ",
            "",
            r":11:3: networks\.adaptation: no input uses .*\.latent; use it",
        ),
        ("inputs: [body, ", "inputs: [", r":8:3: no input uses the observation body; use it"),
        (
            "rate: 5",
            "rate: 15",
            r":16:5: networks\.adaptation\.rate: 15 Hz, the policy acts at 25 Hz",
        ),
        ("rate: 5", "rate: 10", r":16:5: .*10 Hz, the policy acts at 25 Hz; give a rate that div"),
        (
            "adapter: onnx",
            "adapter: act",
            r":12:5: networks\.adaptation\.adapter: 'act' is not one",
        ),
        ("    adapter: onnx\n", "", r"networks\.adaptation: 'adapter' is missing"),
        (
            "inputs: {obs_history: [past]}",
            "inputs: {}",
            r":14:5: .*inputs: is empty; name at least",
        ),
        ("[past]}", "[]}", r":14:14: .*'obs_history' has no observations; name at least one"),
        ("rate: 5", "rats: 5", r":16:5: unknown key 'rats'; did you mean 'rate'\?"),
        ("vel, scale: 2", "-1", r":15:\d+: .*outputs\.velocity\.output: .*must be at least"),
        ("encoder.onnx", "../e.onnx", r":13:18: .*leaves the card's folder"),
        ("    rate: 5", "    recurrent: {obs_history: h}", r":14:14: .* is in `recurrent` too"),
        ("  adaptation:\n", "  past:\n", r":11:3: networks\.past: an observation is called 'past'"),
        (
            "  adaptation:\n",
            "  a.b:\n",
            r":11:3: networks\.a\.b: 'a\.b' is not a valid name; use letters",
        ),
        (
            "inputs: [body, adaptation.latent, adaptation.velocity]\n",
            "",
            r":10:1: `inputs` is miss",
        ),
    ],
)
def test_what_cannot_be_is_said_with_its_place_and_what_would_do(tmp_path, was, becomes, said):
    assert CARD.count(was) == 1
    with pytest.raises(PolicyError) as caught:
        load_card(written(tmp_path, CARD.replace(was, becomes)))
    assert re.search(said, str(caught.value)), str(caught.value)


@pytest.mark.parametrize(
    ("name", "takes", "uses", "way"),
    [
        ("again", "past, again", ", again", r"networks\.again\.inputs: .* again <- again;"),
        ("late", "adaptation.latent", "", r"adaptation\.inputs: .* adaptation <- late <- adaptat"),
    ],
)
def test_networks_in_a_circle_are_refused_with_the_way_round(tmp_path, name, takes, uses, way):
    text = CARD.replace("[past]}", "[past, late]}") if name == "late" else CARD
    text = text[: text.rindex("inputs:")] + ANOTHER.format(name=name, takes=takes, uses=uses)
    with pytest.raises(PolicyError, match=way):
        load_card(written(tmp_path, text))


def test_what_a_script_feeds_back_has_a_place_and_a_shape(tmp_path):
    text = CARD.replace("adapter: onnx", "adapter: torchscript").replace(
        "rate: 5", "recurrent: {h: h_out}"
    )
    with pytest.raises(PolicyError, match=r":16:5: .*have no names, and its inputs no sizes; wri"):
        load_card(written(tmp_path, text))


@pytest.mark.parametrize(
    ("adapter", "fix"), [("zero", ""), ("remote", "on the card that it serves")]
)
def test_networks_need_a_checkpoint_to_feed(tmp_path, adapter, fix):
    text = CARD.replace("adapter: torchscript", f"adapter: {adapter}")
    text = text.replace("checkpoint: {file: body.pt, sha256: B}\n", "")
    with pytest.raises(PolicyError, match=rf":9:1: networks: adapter `{adapter}` has no .*{fix}"):
        load_card(written(tmp_path, text))


def test_every_file_of_weights_is_verified(tmp_path):
    path = written(tmp_path)
    load_bundle(path)
    (tmp_path / "encoder.onnx").write_bytes(b"tampered")
    expected = r"encoder\.onnx: .*that on the card is .*`networks\.adaptation\.checkpoint\.sha256"
    with pytest.raises(PolicyError, match=expected):
        load_bundle(path)
    (tmp_path / "encoder.onnx").unlink()
    with pytest.raises(
        PolicyError, match=r"encoder\.onnx: the checkpoint is missing; put it"
    ) as caught:
        load_bundle(path)
    assert "--checkpoint" not in str(caught.value)


def test_a_network_without_digest_is_taken_as_it_lies_there_and_recorded(tmp_path):
    said, found = load_bundle(written(tmp_path)), CARD.replace(", sha256: E", "")
    bundle = load_bundle(written(tmp_path, found))
    assert bundle.networks["adaptation"].sha256 == DIGESTS["E"]
    assert bundle.checkpoint_digest == said.checkpoint_digest
    (tmp_path / "encoder.onnx").write_bytes(b"another")
    assert load_bundle(tmp_path).checkpoint_digest != said.checkpoint_digest


def test_a_link_to_a_network_out_of_the_folder_is_refused(tmp_path_factory):
    folder, outside = tmp_path_factory.mktemp("card"), tmp_path_factory.mktemp("outside")
    (outside / "link.onnx").write_bytes(ENCODER)
    (folder / "link.onnx").symlink_to(outside / "link.onnx")
    with pytest.raises(PolicyError, match=r"'link\.onnx' is outside the card's folder: a link"):
        load_bundle(written(folder, CARD.replace("encoder.onnx", "link.onnx")))


def test_the_digests_cover_every_file_but_not_where_it_lies(tmp_path):
    first = load_bundle(written(tmp_path))
    (tmp_path / "renamed.onnx").write_bytes(ENCODER)
    renamed = load_bundle(written(tmp_path, CARD.replace("encoder.onnx", "renamed.onnx")))
    assert (renamed.digest, renamed.checkpoint_digest) == (first.digest, first.checkpoint_digest)
    (tmp_path / "other.onnx").write_bytes(b"other weights")
    text = CARD.replace("encoder.onnx, sha256: E", "other.onnx, sha256: O")
    digest = hashlib.sha256(b"other weights").hexdigest()
    other = load_bundle(written(tmp_path, text.replace("sha256: O", f"sha256: {digest}")))
    assert other.checkpoint_sha256 == first.checkpoint_sha256
    assert len({other.digest, first.digest, other.checkpoint_digest, first.checkpoint_digest}) == 4
    slower = load_bundle(written(tmp_path, CARD.replace("rate: 5", "rate: 1")))
    assert slower.checkpoint_digest == first.checkpoint_digest
    assert slower.digest != first.digest


def test_the_order_in_which_a_file_takes_its_inputs_counts(tmp_path):
    both = CARD.replace("{obs_history: [past]}", "{a: [past], b: [body]}")
    turned = CARD.replace("{obs_history: [past]}", "{b: [body], a: [past]}")
    digests = {load_bundle(written(tmp_path, text)).digest for text in (both, turned)}
    assert len(digests) == 2


def test_a_policy_that_nothing_feeds_has_the_digest_of_its_one_file(tmp_path):
    text = CARD[: CARD.index("networks:")]
    bundle = load_bundle(written(tmp_path, text))
    assert bundle.checkpoint_digest == bundle.checkpoint_sha256 == DIGESTS["B"]
