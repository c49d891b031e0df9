"""A leaderboard over saved runs: policies, ties, links, and nothing that a stranger's run names."""

import json
import re
from html.parser import HTMLParser

import pytest
from command_line import ends
from saved_runs import info_of, row_of, save

import nw_eval
from nw_base.digest import digest_of
from nw_base.errors import UsageError
from nw_eval.api.saved_run import saved_trials
from nw_eval.engine.order import shard_of
from nw_eval.suite import new_suite
from nw_gate.results.provenance import (
    PolicyInfo,
    SceneInfo,
    StopInfo,
)
from nw_gate.results.request import Shard
from nw_gate.scores import specs_of

DIGEST, STARTS = "dd" * 32, 12


def save_run(
    path,
    policy,
    reached,
    *,
    suite="tiny",
    seed=7,
    scene="flat/room",
    part=None,
    power=None,
    checkpoint=None,
    card="",
    others=(),
    **changes,
):
    """Save a run of which this many of the trials reached all of four waypoints."""
    scenes = [scene, *others]
    settings = {"name": suite, "robot": "go1", "policy": "stand", "scenes": scenes}
    planned = new_suite({"nw-eval": 1, "trials": STARTS, "seed": seed, **settings})
    checkpoint = checkpoint or policy.encode().hex().ljust(64, "0")[:64]
    info = info_of(
        planned,
        {name: SceneInfo(digest=DIGEST, task="flat", trials=STARTS) for name in scenes},
        id=path.name,
        policy=PolicyInfo(
            name=policy, checkpoint_digest=checkpoint, card=card, card_digest=digest_of(card)
        ),
        engine={"mujoco": "4.0.0", "renderer": "cpu gsplat-1.5", "cpu": "znver4 1f0c77a2"},
        **{"finished": "2026-11-21T11:01:05Z", **changes},
    )
    if power is not None:
        info = info.model_copy(update={"scores": specs_of(["mean_power"])})
    if part is not None:
        share, shard = shard_of(saved_trials(info, planned), part)
        scenes = {scene: SceneInfo(digest=DIGEST, task="flat", trials=len(share))}
        info = info.model_copy(update={"shard": shard, "scenes": scenes})
    scores = () if power is None else (("mean_power", power),)
    own = {"policy": policy, "checkpoint_digest": checkpoint, "scores": scores}
    trials = enumerate(saved_trials(info, planned))
    rows = [row_of(trial, 4 if number < reached else 0, **own) for number, trial in trials]
    return save(path, info, rows, ended=False).path


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    return [
        save_run(folder / "one", "good", 12),
        save_run(folder / "two", "also-good", 11),
        save_run(folder / "three", "bad", 0),
        save_run(folder / "four", "good", 6, suite="other"),
    ]


class Reader(HTMLParser):
    """The words of a page's rows, and where its links lead."""

    def __init__(self, page):
        super().__init__()
        self.rows, self.links, self._open = [], [], False
        self.feed(page.read_text())

    def handle_starttag(self, tag, attrs):
        if tag == "tr":
            self.rows.append([])
        if tag == "a":
            self.links.append(dict(attrs)["href"])
        self._open = tag not in {"style", "script"}

    def handle_data(self, data):
        if self._open and self.rows and data.strip():
            self.rows[-1].append(data.strip())


def test_scores_that_all_of_a_suite_were_measured_by_stand_on_the_board(runs, tmp_path):
    scored = [
        save_run(tmp_path / "thrifty", "thrifty", 12, suite="third", power=81.5),
        save_run(tmp_path / "wasteful", "wasteful", 12, suite="third", power=172.5),
    ]
    page = Reader(nw_eval.write_site([*runs, *scored], tmp_path / "site").page)
    assert ["policy", "mean_power, W, lower is better"] in page.rows
    assert ["thrifty", "81.5"] in page.rows
    assert ["wasteful", "172.5"] in [row[:2] for row in page.rows]
    plain = nw_eval.write_site(runs, tmp_path / "plain").page.read_text()
    assert "Scores on" not in plain


def test_policies_stand_by_suite_with_intervals_and_ties(runs, tmp_path):
    site = nw_eval.write_site(runs, tmp_path / "site")
    assert (site.runs, site.left_out, site.exit_code) == (4, (), 0)
    page = Reader(site.page)
    board = page.rows[:4]
    assert board[0][0] == "policy"
    assert board[1][0] == "good"
    by_name = {row[0]: row for row in board[1:]}
    assert by_name["good"][2] == "0.500", "of the suite that comes first in the alphabet"
    assert "1.000" in by_name["good"]
    assert "rank 1 to 2" in by_name["good"]
    assert "rank 1 to 2" in by_name["also-good"], "eleven of twelve and twelve decide nothing"
    assert "rank 3" in by_name["bad"]


def test_every_number_leads_to_a_report_that_is_there(runs, tmp_path):
    site = nw_eval.write_site(runs, tmp_path / "site")
    pages = (site.page, site.page.with_name("runs.html"))
    links = [link for page in pages for link in Reader(page).links if not link.startswith("#")]
    assert len(links) > 8
    for link in links:
        assert (site.page.parent / link).is_file(), link
    assert len(set(links)) == len(runs) + len(pages)


def test_the_same_runs_give_the_same_bytes_in_any_order_and_replace_a_site(runs, tmp_path):
    first = nw_eval.write_site(runs, tmp_path / "a")
    nw_eval.write_site(runs[:2], tmp_path / "b")
    second = nw_eval.write_site(runs[::-1], tmp_path / "b")
    files = [
        {
            path.relative_to(site.page.parent): path.read_bytes() if path.is_file() else None
            for path in site.page.parent.rglob("*")
        }
        for site in (first, second)
    ]
    assert files[0] == files[1]


def test_runs_that_do_not_compare_stand_apart_with_the_reason(runs, tmp_path):
    other = save_run(tmp_path / "runs" / "five", "good", 12, seed=8)
    site = nw_eval.write_site([*runs, other], tmp_path / "site")
    text = site.page.read_text()
    assert "tiny (1)" in text
    assert "tiny (2)" in text
    assert "its seed is 8, there 7" in text


def test_runs_that_have_not_ended_or_are_damaged_are_left_out_and_named(runs, tmp_path):
    torn = save_run(tmp_path / "runs" / "torn", "good", 12)
    (torn / "run.json").write_text((torn / "run.json").read_text().replace("good", "best"))
    going = save_run(tmp_path / "runs" / "going", "good", 12, finished=None)
    site = nw_eval.write_site([*runs, torn, going], tmp_path / "site")
    assert (site.runs, site.exit_code) == (4, 4)
    assert [sentence.partition(":")[0] for sentence in site.left_out] == ["torn", "going"]
    assert "the run has not ended; --resume it" in site.page.read_text()


def test_a_part_of_a_run_is_left_out(runs, tmp_path):
    part = save_run(tmp_path / "runs" / "part", "good", 12, part=Shard(index=1, count=2))
    site = nw_eval.write_site([*runs, part], tmp_path / "site")
    assert site.left_out == ("part: a part of a run; join the parts with `nw-eval merge`",)


def test_a_folder_of_something_else_stays_as_it_is(runs, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").write_text("mine")
    with pytest.raises(UsageError, match="holds something that is not an nw-eval site"):
        nw_eval.write_site(runs, tmp_path / "mine")
    assert (tmp_path / "mine" / "index.html").read_text() == "mine"
    with pytest.raises(UsageError, match="no run to show"):
        nw_eval.write_site([], tmp_path / "site")
    with pytest.raises(UsageError):
        nw_eval.write_site([tmp_path], tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_reports_that_a_site_has_elsewhere_stay_as_they_are(runs, tmp_path):
    site = nw_eval.write_site(runs, tmp_path / "site").page.parent
    (site / "runs").rename(tmp_path / "elsewhere")
    (site / "runs").symlink_to(tmp_path / "elsewhere")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UsageError, match="holds something that is not an nw-eval site"):
        nw_eval.write_site(runs, tmp_path / "site")
    assert sorted(tmp_path.rglob("*")) == before


def test_what_a_strangers_run_says_is_text_and_opens_nothing(tmp_path):
    hostile = "<script>alert(1)</script>"
    run = save_run(tmp_path / "runs" / "x", hostile, 3, scene="hub:some/where/../../etc")
    site = nw_eval.write_site([run], tmp_path / "site")
    text = site.page.read_text()
    assert hostile not in text
    assert "&lt;script&gt;" in text
    assert "<img" not in text
    inside = {path.relative_to(site.page.parent).parts[0] for path in site.page.parent.rglob("*")}
    badges = {"badge.json", "badge-tiny.json"}
    assert inside == {"index.html", "runs.html", "site.json", "runs"} | badges
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", path.name) for path in site.page.parent.rglob("*"))
    assert "src=" not in text.replace("data:", "")


def test_the_verb_says_where_the_page_is_and_what_it_lacks(runs, tmp_path, capsys):
    going = save_run(tmp_path / "runs" / "going", "good", 12, finished=None)
    words = ("--site", tmp_path / "site", "--title", "Walkers")
    assert ends("report", *words, runs[0], going) == 4
    printed = capsys.readouterr()
    assert printed.out == f"leaderboard of 1 run: {tmp_path / 'site' / 'index.html'}\n"
    assert "left out: going: the run has not ended" in printed.err
    assert "<h1>Walkers</h1>" in (tmp_path / "site" / "index.html").read_text()


def test_badges_say_what_the_latest_run_of_each_suite_came_to(runs, tmp_path):
    newer = save_run(tmp_path / "runs" / "late", "late", 3, started="2026-12-01T00:00:00Z")
    site = nw_eval.write_site([newer, *runs], tmp_path / "site")
    assert [path.name for path in site.badges] == [
        *("badge.json", "badge-other.json", "badge-tiny.json")
    ]
    found = [json.loads(path.read_text()) for path in site.badges]
    assert [each["schemaVersion"] for each in found] == [1, 1, 1]
    assert [(each["label"], each["message"], each["color"]) for each in found] == [
        ("nw-eval", "2 RAN", "blue"),
        ("other", "RAN, good 0.500", "blue"),
        ("tiny", "RAN, late 0.250", "blue"),
    ]
    nw_eval.write_site(runs[:3], tmp_path / "site")
    assert not site.badges[1].exists(), "a badge of a suite that the site no longer has"


def test_policies_of_one_name_are_told_apart_by_their_training_steps(tmp_path):
    steps = [
        save_run(
            tmp_path / "runs" / f"at-{step}", "walker", reached,
            checkpoint=digest * 32, labels={"step": step},
        )
        for step, reached, digest in (("500", 3, "aa"), ("1000", 12, "bb"))
    ]  # fmt: skip
    site = nw_eval.write_site(steps, tmp_path / "site")
    board = Reader(site.page).rows[1:3]
    assert board[0][1] != board[1][1], "the digests of two checkpoints"
    assert [[row[0], *row[2:4]] for row in board] == [
        ["walker", "step 1000", "1.000"],
        ["walker", "step 500", "0.250"],
    ]


def test_three_cards_with_one_checkpoint_are_three_policies(tmp_path):
    folders = [
        save_run(
            tmp_path / "runs" / f"of-{name}", "walker", reached,
            card=f"policies/{name}/policy.yaml",
        )
        for name, reached in (("a", 12), ("b", 6), ("c", 3))
    ]  # fmt: skip
    site = nw_eval.write_site(folders, tmp_path / "site")
    board = Reader(site.page).rows[1:4]
    assert [[row[0], row[2]] for row in board] == [["a", "1.000"], ["b", "0.500"], ["c", "0.250"]]
    assert len({row[1] for row in board}) == 3
    runs = Reader(site.page.with_name("runs.html"))
    named = {row[0] for row in runs.rows if row}
    assert named >= {"a", "b", "c"}


def test_a_run_that_was_stopped_early_stands_there_without_a_rank(tmp_path):
    """It had shown enough before it met all scenes: it is not left out."""
    others = ["flat/hall", "flat/yard"]
    whole = save_run(tmp_path / "runs" / "whole", "good", 36, others=others)
    drawn = {"drawn_from": STARTS, "drawn_for": "candidate"}
    stop = StopInfo(first=2, trials=drawn_in(2, others))
    early = save_run(tmp_path / "runs" / "early", "bad", 0, others=others, stop=stop, **drawn)
    site = nw_eval.write_site([whole, early], tmp_path / "site")
    assert (site.runs, site.left_out, site.exit_code) == (2, (), 0)
    page = Reader(site.page)
    by_name = [row for row in page.rows if row[0] == "bad"]
    assert by_name[0][2] == "0.000"
    assert "stopped early" in by_name[0]
    assert page.rows[1][0] == "good"
    assert "decided after 2 of 36 trials; the rest were skipped" in by_name[1]
    alone = nw_eval.write_site([early], tmp_path / "alone")
    assert (alone.runs, alone.left_out) == (1, ())
    assert "decided after 2 of 36 trials; the rest were skipped" in alone.page.read_text()


def drawn_in(first, others):
    """Return how many of the first drawn trials are of each scene."""
    suite = new_suite(
        {
            "nw-eval": 1, "trials": STARTS, "seed": 7, "name": "tiny", "robot": "go1",
            "policy": "stand", "scenes": ["flat/room", *others],
        }
    )  # fmt: skip
    info = info_of(
        suite,
        {
            name: SceneInfo(digest=DIGEST, task="flat", trials=STARTS)
            for name in ("flat/room", *others)
        },
        policy=PolicyInfo(name="bad", checkpoint_digest=b"bad".hex().ljust(64, "0")),
        drawn_from=STARTS,
        drawn_for="candidate",
    )
    met = [trial.scene for trial in saved_trials(info, suite) if trial.place < first]
    return {name: met.count(name) for name in sorted(set(met))}


def test_a_glob_over_runs_finds_pages_and_badges_of_before_and_skips_them(tmp_path, capsys):
    save_run(tmp_path / "lb" / "one", "good", 12)
    save_run(tmp_path / "lb" / "two", "bad", 3)
    (tmp_path / "lb" / "notes.txt").write_text("mine")

    def report(*options):
        found = sorted(str(path) for path in (tmp_path / "lb").iterdir())
        return ends("report", *found, "--no-pictures", *options), capsys.readouterr()

    first, again = report(), report()
    assert (first[0], again[0]) == (0, 0)
    assert first[1].out == again[1].out == f"index of 2 runs: {tmp_path / 'lb' / 'index.html'}\n"
    assert "skipped 1 path without a run:" in first[1].err
    skipped = (
        "5 paths without a run: badge-tiny.json, badge.json, index-runs, index.html and 1 more"
    )
    assert skipped in again[1].err
    code, printed = report("--site", str(tmp_path / "site"))
    assert (code, "skipped 5 paths" in printed.err) == (0, True)
    with pytest.raises(UsageError, match="is not the folder of a run"):
        nw_eval.index_runs([tmp_path / "lb" / "notes.txt", tmp_path / "lb" / "badge.json"])
    with pytest.raises(UsageError, match="gone"):
        nw_eval.index_runs([tmp_path / "lb" / "one", tmp_path / "lb" / "gone"])
