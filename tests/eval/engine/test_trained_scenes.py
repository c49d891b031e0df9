"""Which scenes a policy was trained in, by its card: what run.json says and reports mark."""

import pytest

from nw_base.files.shipped import available
from nw_eval import api
from nw_eval.engine.how import How
from nw_eval.engine.provenance import run_info, split_for
from nw_gate.results.run_folder import RunFolder
from nw_policies import load_bundle
from nw_policies.cards import load_card
from nw_sim.catalogue import FoundScene


def card(*trained_on):
    shipped = load_card(available("policies")["stand"] / "policy.yaml")
    return shipped.model_copy(update={"trained_on": trained_on})


@pytest.mark.parametrize(
    ("trained_on", "splits"),
    [
        ((), (None, None, None)),
        (("split:train",), ("train", "train", "eval")),
        (("split:train~3",), ("train", "train", "eval")),
        (("hurdles/*",), ("train", "train", "train")),
        (("gaps/*",), ("eval", "eval", "eval")),
        (("hurdles/*~3", "!split:eval"), ("train", "train", "eval")),
        (("hurdles/*~3", "!hurdles/one_*~3"), ("eval", "eval", "train")),
        (("hurdles/*", "hurdles/*~3", "!hurdles/one_*~3"), ("train", "train", "train")),
    ],
)
def test_a_scene_is_train_where_the_card_names_it_and_else_eval(trained_on, splits):
    names = ("hurdles/one_low_carpet", "hurdles/one_low_carpet~2", "hurdles/three_low")
    found = [split_for(card(*trained_on), FoundScene.at(name)) for name in names]
    assert tuple(found) == splits


def test_the_shipped_students_say_where_they_were_trained_and_no_digest_moves(tmp_path):
    for name, digest in {
        "go1-act-rgb": "efb1688a0a2c2f06",
        "go1-act-depth": "54ff1337fb024f2d",
    }.items():
        bundle = load_bundle(available("policies")[name])
        assert bundle.card.trained_on == ("split:train",)
        assert bundle.checkpoint_digest.startswith(digest)
        plain = load_bundle(available("policies")[name])
        object.__setattr__(plain, "card", plain.card.model_copy(update={"trained_on": ()}))
        assert plain.digest == bundle.digest
    assert load_bundle(available("policies")["go1-parkour"]).card.trained_on == ()
    text = (
        "nw-eval: 1\nname: two\nrobot: go1\npolicy: go1-act-depth\ntrials: 1\nseed: 7\n"
        "episode: {duration: 0.1}\nrecord: none\n"
        "scenes: [hurdles/one_low_carpet, hurdles/three_low, flat/carpet_room]\n"
    )
    (tmp_path / "two.yaml").write_text(text)
    plan, folder = api.plan(tmp_path / "two.yaml"), RunFolder(path=tmp_path / "run")
    info = run_info(plan, folder, How(in_process=True), workers=1)
    assert {name: scene.split for name, scene in info.scenes.items()} == {
        "hurdles/one_low_carpet": "train",
        "hurdles/three_low": "eval",
        "flat/carpet_room": None,
    }


def test_a_glob_over_scenes_means_no_rung_of_a_ladder():
    rung = FoundScene.at("hurdles/bar@0.3")
    assert split_for(card("hurdles/*"), rung) is None
    assert split_for(card("*"), rung) is None
    assert split_for(card("hurdles/bar@*"), rung) == "train"
