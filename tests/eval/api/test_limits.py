"""A search for limits from ladder to page, with policies that stand and walk."""

import json
import re
import shutil
from dataclasses import replace
from io import BytesIO

import pytest
from PIL import Image, ImageSequence

import nw_eval
from nw_base.errors import IncomparableError, SceneError, SuiteError, UsageError
from nw_eval import api
from nw_eval.api import climbing
from nw_eval.api.ladder_runs import folder_names
from nw_eval.api.proposals import write_limits_suite
from nw_eval.cli import main
from nw_eval.engine.listener import NullListener
from nw_eval.reporting.markdown import render_markdown
from nw_eval.suite import load_suite
from nw_gate.limits.limit import Limit
from nw_gate.results.row import rows_digest
from nw_policies import find_card


def rows_of(found):
    (each,) = found.limits
    return api.report(each.run).rows


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """What a policy that stands still clears of the stairs."""
    out = tmp_path_factory.mktemp("limits") / "standing"
    return api.limits(["stairs/up"], policy="stand", out=out, workers=1)


def test_who_stands_still_clears_nothing_and_that_takes_ten_trials(standing):
    (each,) = standing.limits
    assert (each.policy, each.ladder) == ("stand", "stairs/up")
    assert each.limit.lower is None
    assert each.limit.upper.value == 0.1
    assert each.limit.decided
    assert len(each.limit.trials) <= 10
    assert not standing.interrupted


def test_the_trials_of_a_search_are_a_run_that_can_be_judged_again(standing):
    rows = rows_of(standing)
    (each,) = standing.limits
    assert len(rows) == len(each.limit.trials)
    assert {row.status for row in rows} == {"ok"}
    assert not any(row.completed for row in rows)
    assert all(row.scene.startswith("stairs/up@") for row in rows)


def test_a_report_of_a_search_claims_no_success_and_its_trials_can_be_verified(standing):
    (each,) = standing.limits
    judged = api.report(each.run)
    assert (judged.verdict.verdict, judged.verdict.success) == ("RAN", None)
    assert any("limits.md" in reason for reason in judged.verdict.reasons)
    page = render_markdown(judged.info, judged.rows, judged.verdict, each.run)
    assert "success is" not in page
    verified = api.verify(each.run, trials=1, workers=1)
    assert len(verified.repeats.trials) == 1
    assert verified.is_as_it_was
    with pytest.raises(IncomparableError, match="`nw-eval limits` chose its trials"):
        api.run(resume=each.run)


def test_two_workers_find_the_same_limit_by_the_same_trials(standing, tmp_path):
    again = api.limits(["stairs/up"], policy="stand", out=tmp_path / "again", workers=2)
    assert again.limits[0].limit == standing.limits[0].limit
    assert rows_digest(rows_of(again)) == rows_digest(rows_of(standing))


def test_the_files_say_what_was_found(standing):
    saved = json.loads((standing.out / "limits.json").read_text())
    (each,) = saved["limits"]
    assert (each["lower"], each["upper"], each["unit"]) == (None, 0.1, "m")
    assert Limit.from_dict(each["limit"]) == standing.limits[0].limit
    page = (standing.out / "limits.html").read_text()
    assert "cleared: <strong>none</strong>, not cleared: <strong>0.1\u00a0m</strong>" in page
    table = " ".join((standing.out / "limits.md").read_text().split())
    assert "| stairs/up | stand | none | 0.1 m |" in table


def test_the_page_shows_a_trial_on_either_side_of_the_limit_and_stays_light(tmp_path):
    found = api.limits(["stairs/up"], policy="go1-parkour", trials=8, out=tmp_path / "new")
    (each,) = found.limits
    says = [film.says for film in each.films]
    assert [text.endswith(": completed") for text in says] == [True, False]
    easier, harder = (float(text.split()[0]) for text in says)
    assert easier < harder
    for film in each.films:
        moving = Image.open(BytesIO(film.film.data))
        assert moving.n_frames > 10
        assert len({frame.tobytes() for frame in ImageSequence.Iterator(moving)}) > 5
    page = (found.out / "limits.html").read_bytes()
    assert page.count(b"data:image/webp") == 4  # A still and a film of each.
    assert len(page) < 300_000


@pytest.mark.nightly
def test_films_are_left_out_where_nobody_wants_them_or_they_cannot_be_drawn(
    standing, tmp_path, monkeypatch
):
    (each,) = standing.limits
    assert [film.says.split()[0] for film in each.films] == ["0.1"]  # None was completed.
    without = api.limits(
        ["stairs/up"], policy="stand", films=False, out=tmp_path / "without", workers=1
    )
    assert not without.limits[0].films
    assert b"data:image" not in (without.out / "limits.html").read_bytes()

    monkeypatch.setattr(climbing, "_FILMS_SECONDS", 0.0)
    late = api.limits(["stairs/up"], policy="stand", seed=2, out=tmp_path / "late", workers=1)
    assert late.limits[0].limit.decided
    assert not late.limits[0].films
    assert "Films of stairs/up are missing: " in (late.out / "limits.html").read_text()


def test_pages_over_runs_draw_limits_over_training_steps_and_the_board_has_a_column(tmp_path):
    for step in (100, 200):
        api.limits(
            ["stairs/up"],
            policy="stand",
            out=tmp_path / "reports" / f"limits-{step}",
            labels={"step": str(step), "training_run": "may"},
            films=False,
            workers=1,
        )
    folders = sorted((tmp_path / "reports").iterdir())
    listed = api.index_runs(folders, out=tmp_path / "index.html", pictures=False)
    assert not listed.unread
    page = listed.page.read_text()
    assert "five steps up: rise of the steps, m, by training step" in page
    assert page.count(": easier than 0.1\u00a0m</title>") == 2
    assert page.count('data-of="not cleared at">0.1\u00a0m</td>') == 2
    linked = {tmp_path / link for link in re.findall(r'href="([^"#]+limits.html)"', page)}
    assert len(linked) == 2
    assert all(link.is_file() for link in linked)

    site = api.write_site(folders, tmp_path / "site", pictures=False)
    assert not site.left_out
    (cell,) = re.findall(
        r'data-of="stairs/up"><a href="([^"]+)">([^<]+)</a>', site.page.read_text()
    )
    assert cell[1] == "easier than 0.1\u00a0m"
    assert (tmp_path / "site" / cell[0]).is_file()


def test_limits_that_are_not_those_of_their_trials_are_named_and_not_shown(standing, tmp_path):
    other = shutil.copytree(standing.out, tmp_path / "other")
    saved = json.loads((other / "limits.json").read_text())
    saved["limits"][0]["limit"]["trials"] = [[0, 1]] * 30
    (other / "limits.json").write_text(json.dumps(saved))
    damaged = shutil.copytree(standing.out, tmp_path / "damaged")
    (damaged / "limits.json").write_text("{")
    outside = shutil.copytree(standing.out, tmp_path / "outside")
    saved["limits"][0]["run"] = "../damaged/stairs-up/1"
    (outside / "limits.json").write_text(json.dumps(saved))
    listed = api.index_runs([other, damaged, outside], out=tmp_path / "index.html", pictures=False)
    assert listed.exit_code == 4
    other_says, damaged_says, outside_says = listed.unread
    assert "other: the limit on stairs/up is not of the trials of 1" in other_says
    assert "damaged: " in damaged_says
    assert "limits.json cannot be read" in damaged_says
    assert "outside: " in outside_says
    assert "or harder" not in listed.page.read_text()


def limit_of(standing, ladder, cleared):
    """Return a limit as if 40 trials were completed at one rung and none at the next."""
    (each,) = standing.limits
    known = nw_eval.rungs_of(ladder)
    rungs = tuple(rung.value for rung in known)
    trials = ((cleared, True),) * 40 + ((cleared + 1, False),) * 40
    inside = tuple(trial for trial in trials if 0 <= trial[0] < len(rungs))
    ladder_of_it = replace(each.limit.ladder, rungs=rungs)
    limit = replace(each.limit, ladder=ladder_of_it, trials=inside, staked=len(inside))
    return replace(each, ladder=ladder, limit=limit)


def test_a_suite_has_the_rungs_around_limits_that_have_two_bounds(standing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "around.yaml"
    limits = [
        limit_of(standing, "stairs/up", 4),
        limit_of(standing, "hurdles/bar", -1),
        limit_of(standing, "hurdles/one_low_carpet+strength", 3),
    ]
    left = write_limits_suite(file, limits, robot="go1", policy="stand", seed=1)
    assert left == ("hurdles/bar", "hurdles/one_low_carpet+strength")
    rungs = nw_eval.rungs_of("stairs/up")
    written = load_suite(file)
    assert written.scenes == (rungs[4].scene, rungs[5].scene)
    assert (written.name, written.policy, written.seed) == ("around", "stand", 2)
    assert main_ends("check", str(file)) == 0


def test_a_suite_without_a_limit_is_refused(standing, tmp_path):
    limits = [limit_of(standing, "hurdles/bar", -1)]
    with pytest.raises(UsageError, match="no ladder has a limit with two bounds; the limits them"):
        write_limits_suite(tmp_path / "x.yaml", limits, robot="go1", policy="stand", seed=1)
    assert not (tmp_path / "x.yaml").exists()
    with pytest.raises(UsageError, match=r"rungs of hurdles/one_low_carpet\+strength are pertur"):
        api.limits(
            ["hurdles/one_low_carpet+strength"], policy="stand", write_suite=tmp_path / "x.yaml"
        )


def main_ends(*words):
    with pytest.raises(SystemExit) as left:
        main([*words])
    return left.value.code


def test_a_suite_means_the_ladders_that_its_gate_judges(tmp_path):
    suite = tmp_path / "steps.yaml"
    text = (
        "nw-eval: 1\nname: steps\nrobot: go1\npolicy: stand\ntrials: 1\nseed: 7\n"
        "scenes: [flat/carpet_room]\n"
    )
    suite.write_text(text + "gate: {limits: {stairs/down: {at_least: 0.1}}}\n")
    found = api.limits([str(suite)], policy="stand", out=tmp_path / "new", films=False, trials=2)
    assert [each.ladder for each in found.limits] == ["stairs/down"]
    suite.write_text(text)
    with pytest.raises(UsageError, match=r"steps\.yaml names no ladder"):
        api.limits([str(suite)], policy="stand")


def test_rungs_of_a_perturbation_are_climbed_in_one_scene(tmp_path):
    found = api.limits(
        ["hurdles/one_low_carpet+strength"], policy="stand", out=tmp_path / "new", trials=4
    )
    rows = rows_of(found)
    assert {row.scene for row in rows} == {"hurdles/one_low_carpet"}
    assert {axis for row in rows for axis, _ in row.perturbation} == {"strength"}
    assert len(rows) <= 4


def test_a_ladder_of_commands_has_trials_of_the_task_velocity(tmp_path):
    found = api.limits(["open/field+speed"], policy="stand", out=tmp_path / "new", trials=5)
    rows = rows_of(found)
    assert {name for row in rows for name, _ in row.scores} == {"tracked_time"}, "of velocity"
    assert {axis for row in rows for axis, _ in row.perturbation} == {"speed"}
    assert [row.completed for row in rows] == [False] * 5


def test_on_a_leaderboard_limits_that_were_asked_otherwise_have_columns_of_their_own(
    standing, tmp_path
):
    asked = {"contacts": {"contacts": True}, "most": {"share": 0.9}}
    for name, options in asked.items():
        api.limits(["stairs/up"], policy="stand", out=tmp_path / name, workers=1, **options)
    api.write_site([standing.out, *(tmp_path / name for name in asked)], tmp_path / "site")
    page = (tmp_path / "site" / "index.html").read_text()
    columns = re.findall(r"<th[^>]*>\s*(stairs/up[^<]*?)\s*</th>", page)
    assert columns == ["stairs/up", "stairs/up, 90\xa0% of trials", "stairs/up, with contacts"]


def test_what_cannot_be_climbed_is_said_before_anything_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError, match=r"no ladder 'stairs/upp'.* did you mean 'stairs/up'"):
        api.limits(["stairs/upp"], policy="stand")
    with pytest.raises(SuiteError, match=r"open/field\+turn_rate.* does not observe yaw"):
        api.limits(["open/field+turn_rate"], policy="go1-parkour")
    with pytest.raises(UsageError, match="share 1 is not between 0 and 1"):
        api.limits(["stairs/up"], policy="stand", share=1.0)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="full is not empty"):
        api.limits(["stairs/up"], policy="stand", out="full")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]


def test_two_policies_of_one_name_are_told_apart_and_one_is_not_compared_with_itself(tmp_path):
    own = tmp_path / "stand"
    shutil.copytree(find_card("stand").parent, own)
    card = own / "policy.yaml"
    card.write_text(card.read_text().replace("control: {", "control: {kp: 25, ", 1))
    found = api.limits(
        ["stairs/up"], policy="stand", baseline=str(own), trials=1, out=tmp_path / "two"
    )
    one, two = (each.policy for each in found.limits)
    assert one != two
    assert one.startswith("stand (")
    assert two.startswith("stand (")
    with pytest.raises(UsageError, match="--baseline stand is the policy itself"):
        api.limits(["stairs/up"], policy="stand", baseline="stand")


def test_ladders_whose_names_are_alike_have_folders_of_their_own():
    names = ["a/b", "a-b", "./a-b", "\u043b\u0430\u0434"]
    assert folder_names(names) == ["a-b", "a-b-2", "a-b-3", "ladder"]


def test_a_touch_ends_no_trial_where_contacts_are_allowed(tmp_path):
    for contacts, ends in ((False, True), (True, False)):
        found = api.limits(
            ["hurdles/block"], policy="go1-parkour", trials=6, contacts=contacts, films=False,
            out=tmp_path / f"{contacts}",
        )  # fmt: skip
        assert any(row.outcome == "collided" for row in rows_of(found)) is ends


def test_a_seed_below_zero_is_refused(tmp_path):
    with pytest.raises(UsageError, match="--seed -1 is below 0"):
        api.limits(["stairs/up"], policy="stand", seed=-1, out=tmp_path / "new")


def test_a_search_that_is_cut_short_is_called_undecided(tmp_path):
    heard = []

    class Hearing(NullListener):
        def message(self, text):
            heard.append(text)

    api.limits(["stairs/up"], policy="stand", trials=2, out=tmp_path / "new", listener=Hearing())
    assert "undecided after 2 trials" in heard
    assert not any("decided after" in text and "undecided" not in text for text in heard)


def test_the_command_prints_a_table_or_json(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["limits", "stairs/up", "-p", "stand", "-n", "3", "--workers", "1"]
    for more in ([], ["--json"]):
        with pytest.raises(SystemExit) as left:
            main([*words, *more])
        assert left.value.code == 0
    printed = capsys.readouterr().out
    table, _, rest = printed.partition("{")
    assert "stairs/up  stand   none           none                 3  no" in table
    assert "reports/limits-001/limits.html" in table
    assert json.loads("{" + rest)["limits"][0]["decided"] is False


@pytest.mark.nightly
def test_a_walker_clears_what_the_published_completions_say(tmp_path):
    """Completed 22 of 24 at 0.20 m, 14 of 24 at 0.22 m and 1 of 24 at 0.24 m."""
    found = api.limits(["stairs/up"], policy="go1-parkour", out=tmp_path / "new")
    limit = found.limits[0].limit
    assert limit.decided
    assert 0.16 <= limit.lower.value <= 0.22
    assert 0.22 <= limit.upper.value <= 0.26
    assert len(limit.trials) <= 60
