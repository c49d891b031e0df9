"""Episodes of any simulator are read as it wrote them, and judged with the errors that are said."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_gate import Columns, Episode, Evaluation, JudgeSettings, judge, read_evaluation
from nw_gate.cli import main
from nw_gate.stats.betting import evidence_above

PLAIN = [("lift", 0, 1), ("lift", 1, 0), ("push", 0, 1)]


def episodes(found):
    return [(each.task, each.score, each.start) for each in found.episodes]


def csv(path, rows=PLAIN, heading="task,seed,success"):
    path.write_text("\n".join([heading, *(",".join(map(str, row)) for row in rows)]))
    return path


def parquet(path):
    task, seed, success = zip(*PLAIN, strict=True)
    columns = {"scene": task, "seed_index": seed, "success": success, "image": [b"\xff"] * 3}
    pq.write_table(pa.table(columns), path)


def lerobot_tasks(path):
    metrics = [{"successes": [True, False], "sum_rewards": [1.0, 0.0]}, {"successes": [True]}]
    tasks = [
        {"task_group": "libero", "task_id": index, "metrics": each}
        for index, each in enumerate(metrics)
    ]
    path.write_text(json.dumps({"per_task": tasks, "overall": {"pc_success": 66.7}}))


def inspect_log(epochs=(1, 2)):
    samples = [
        {"id": "a", "epoch": epoch, "scores": {"match": {"value": "C" if epoch == 1 else "I"}}}
        for epoch in epochs
    ]
    return {"version": 2, "eval": {"task": "arm"}, "samples": samples}


FORMATS = {
    "a.csv": (csv, [("lift", 1.0, "0"), ("lift", 0.0, "1"), ("push", 1.0, "0")]),
    "a.parquet": (parquet, [("lift", 1.0, "0"), ("lift", 0.0, "1"), ("push", 1.0, "0")]),
    "a.jsonl": (
        lambda path: path.write_text(
            "\n".join(
                json.dumps({"env_id": t, "episode": s, "success": bool(x)}) for t, s, x in PLAIN
            )
        ),
        [("lift", 1.0, "0"), ("lift", 0.0, "1"), ("push", 1.0, "0")],
    ),
    "eval_info.json": (
        lerobot_tasks,
        [("libero/0", 1.0, "0"), ("libero/0", 0.0, "1"), ("libero/1", 1.0, "0")],
    ),
    "older.json": (
        lambda path: path.write_text(
            json.dumps(
                {
                    "per_episode": [
                        {"episode_ix": index, "sum_reward": 0.5, "success": good, "seed": 9 + index}
                        for index, good in enumerate((True, False))
                    ],
                    "aggregated": {"pc_success": 50.0},
                }
            )
        ),
        [("all", 1.0, "0"), ("all", 0.0, "1")],
    ),
    "log.json": (
        lambda path: path.write_text(json.dumps(inspect_log())),
        [("arm", 1.0, "a:1"), ("arm", 0.0, "a:2")],
    ),
    "robomimic.json": (
        lambda path: path.write_text(json.dumps({"Success_Rate": 0.75, "Num_Success": 3.0})),
        [("all", 1.0, None)] * 3 + [("all", 0.0, None)],
    ),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_is_read_as_its_simulator_wrote_it(name, tmp_path):
    write, said = FORMATS[name]
    write(tmp_path / name)
    assert episodes(read_evaluation(tmp_path / name)) == said


def test_a_packed_log_of_inspect_is_read(tmp_path):
    log = inspect_log()
    with zipfile.ZipFile(tmp_path / "a.eval", "w") as archive:
        archive.writestr("header.json", json.dumps({"version": 2, "eval": log["eval"]}))
        for sample in log["samples"]:
            archive.writestr(f"samples/a_epoch_{sample['epoch']}.json", json.dumps(sample))
    found = read_evaluation(tmp_path / "a.eval")
    assert episodes(found) == [("arm", 1.0, "a:1"), ("arm", 0.0, "a:2")]


def test_columns_are_named_where_their_names_do_not_say_it(tmp_path):
    rows = [("x", "p", 0, 40), ("x", "q", 0, 100), ("y", "p", 1, 0)]
    path = csv(tmp_path / "a.csv", rows, "kind,object,n,percent")
    columns = Columns(score="percent", task="kind,object", start="n", span=(0.0, 100.0))
    found = episodes(read_evaluation(path, columns))
    assert found == [("x/p", 0.4, "0"), ("x/q", 1.0, "0"), ("y/p", 0.0, "1")]


def test_two_columns_together_are_the_start_where_neither_is_alone(tmp_path):
    rows = [(0, 0, 1), (0, 1, 0), (1, 0, 1)]
    path = csv(tmp_path / "a.csv", rows, "seed,episode_id,success")
    assert [each.start for each in read_evaluation(path).episodes] == ["0/0", "1/0", "0/1"]


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        ("a,b\n1,2\n", Columns(), "no column that is known to be a score; name it with --score"),
        ("success\nperhaps\n", Columns(), "episode 1: success 'perhaps' is not a number"),
        ("success\n0.5\n7\n", Columns(), "episode 2: success 7 is not between 0 and 1"),
        ("success\n1\n", Columns(score="sucess"), "no column 'sucess'; did you mean 'success'"),
        ("seed,success\n1,1\n1,0\n", Columns(start="seed"), "seed does not tell the episodes"),
        ("success\n", Columns(), "has no episodes"),
        ("success\n1,2\n", Columns(), "line 2 has more cells than the heading"),
    ],
)
def test_what_cannot_be_read_says_what_and_where(text, columns, said, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UsageError, match=said):
        read_evaluation(tmp_path / "a.csv", columns)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.json", b"{}"),
        ("a.json", b'{"one": {"per_task": []}, "two": {}}'),
        ("a.json", b"[1]"),
        ("a.json", b'{"Success_Rate": 0.0, "Num_Success": 0}'),
        ("a.json", b"[" * 100_000),
        ("a.jsonl", b"success"),
        ("a.eval", b"PK"),
        ("a.csv", b"\xff\xfe\x00"),
        ("a.txt", b"success\n1\n"),
    ],
)
def test_a_file_of_another_kind_is_an_error_of_ours(name, data, tmp_path, capsys):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SystemExit) as left:
        main(["judge", str(tmp_path / name), "--bar", "0.5"])
    assert left.value.code == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_a_part_of_a_file_that_holds_several_is_named(tmp_path, capsys):
    parts = {name: {"per_episode": [{"success": name == "a"}] * 60} for name in "ab"}
    (tmp_path / "e.json").write_text(json.dumps(parts))
    with pytest.raises(UsageError, match="several evaluations, or none; name one with --part: a"):
        read_evaluation(tmp_path / "e.json")
    both = [str(tmp_path / "e.json")] * 2
    with pytest.raises(SystemExit) as left:
        main(["judge", both[0], "--baseline", both[1], "--part", "b", "--baseline-part", "a"])
    assert left.value.code == 1
    assert capsys.readouterr().out.startswith("REGRESSED\n  the drop is +1.000")


def drawn(rates, n, rng, *, starts=True):
    """Episodes with these rates of success in as many tasks."""
    return Evaluation(
        name="drawn",
        score="success",
        episodes=tuple(
            Episode(
                task=f"t{t}", score=float(rng.random() < rate), start=str(i) if starts else None
            )
            for i in range(n)
            for t, rate in enumerate(rates)
        ),
    )


@pytest.mark.parametrize(
    ("drop", "wrong", "most"),
    [(0.10, "PASS", 0.05), (0.02, "REGRESSED", 0.01)],
)
def test_wrong_verdicts_are_as_rare_as_is_said(drop, wrong, most):
    rng, gates = np.random.default_rng(5), 300
    rates = np.array([0.5, 0.7, 0.9])
    words = [judge(drawn(rates - drop, 60, rng), drawn(rates, 60, rng)).word for _ in range(gates)]
    # Three standard errors of the share, so that one seed in a thousand is unlucky.
    assert words.count(wrong) / gates <= most + 3.0 * (most * (1.0 - most) / gates) ** 0.5


def test_episodes_sorted_by_their_score_decide_nothing():
    rng = np.random.default_rng(4)

    def by_score(rates):
        found = drawn(rates, 60, rng)
        order = sorted(found.episodes, key=lambda episode: -episode.score)
        return replace(found, episodes=tuple(replace(each, start=None) for each in order))

    worse, better = by_score([0.7, 0.7]), by_score([0.95, 0.95])
    found = judge(worse, better)
    assert (found.word, found.decided_after) == ("INCONCLUSIVE", None)
    assert "episodes of each task say PASS, and all of them a drop of +0." in found.reasons[0]
    assert "the order of the episodes may depend on their scores" in found.reasons[0]
    assert judge(better, worse).word != "REGRESSED"


def test_rounds_are_whole_and_their_capital_is_that_of_the_bounds():
    rng = np.random.default_rng(3)
    new, old = drawn([0.1, 0.4], 90, rng), drawn([0.9, 0.8], 90, rng)
    found = judge(new, old)
    assert found.word == "REGRESSED"
    sides = []
    for count in (found.decided_after - 1, found.decided_after):
        pairs = zip(new.episodes[: 2 * count], old.episodes[: 2 * count], strict=True)
        values = [(1.0 - c.score + b.score) / 2.0 for c, b in pairs]
        groups = [np.array(values[::2]), np.array(values[1::2])]
        sides.append(evidence_above(groups, 0.51) >= 100.0)
    assert sides == [False, True]
    longer = replace(new, episodes=(*new.episodes, *[replace(new.episodes[0], start="90")] * 50))
    again = judge(
        longer, replace(old, episodes=(*old.episodes, *[replace(old.episodes[0], start="90")]))
    )
    assert [task.pairs for task in again.tasks] == [90, 90]


def test_a_cell_of_a_csv_may_have_line_ends(tmp_path):
    (tmp_path / "a.csv").write_text('task,success\n"pick\nplace",1\n')
    assert episodes(read_evaluation(tmp_path / "a.csv")) == [("pick\nplace", 1.0, None)]


def test_large_differences_are_found_early_and_equal_policies_pass():
    rng = np.random.default_rng(0)
    worse = judge(drawn([0.4, 0.5], 200, rng), drawn([0.9, 0.9], 200, rng))
    assert (worse.word, worse.decided_after < 40) == ("REGRESSED", True)
    assert [task.fell for task in worse.tasks] == [True, True]
    same = drawn([0.8, 0.6], 200, rng)
    found = judge(same, same)
    assert (found.word, found.drop, found.paired_by) == ("PASS", 0.0, "start")


@pytest.mark.parametrize(
    ("critical", "word"), [((), "INCONCLUSIVE"), (("t1",), "REGRESSED"), (("x*",), "INCONCLUSIVE")]
)
def test_a_task_that_fell_is_named_and_a_critical_one_decides(critical, word):
    rng = np.random.default_rng(2)
    new, old = drawn([0.9, 0.0], 40, rng), drawn([0.0, 0.9], 40, rng)
    found = judge(new, old, JudgeSettings(critical=critical))
    assert found.word == word
    (said,) = [why for why in found.reasons if "fell" in why]
    assert said.startswith("t1 fell by over 0.1: 0.") == ("to 0.000" in said) is True


def test_episodes_without_the_same_starts_are_paired_by_order_and_it_is_said():
    rng = np.random.default_rng(1)
    one = drawn([0.9], 150, rng, starts=False)
    found = judge(one, drawn([0.9], 150, rng))
    assert found.paired_by == "order"


def test_an_episode_without_a_score_never_lets_a_policy_pass(tmp_path):
    rows = [("t", i, "" if i == 7 else 1) for i in range(200)]
    new = read_evaluation(csv(tmp_path / "new.csv", rows))
    old = read_evaluation(csv(tmp_path / "old.csv", [("t", i, 1) for i in range(200)]))
    found = judge(new, old)
    assert (found.word, found.missing) == ("INCONCLUSIVE", 1)
    assert "1 episode without a score: PASS needs all of them" in found.reasons


def test_other_tasks_are_not_compared(tmp_path):
    new = read_evaluation(csv(tmp_path / "new.csv"))
    old = read_evaluation(csv(tmp_path / "old.csv", PLAIN[:2]))
    with pytest.raises(IncomparableError, match=r"old.csv lacks push"):
        judge(new, old)


@pytest.mark.parametrize(
    ("bar", "word"), [(0.6, "PASS"), (0.8, "INCONCLUSIVE"), (0.97, "REGRESSED")]
)
def test_a_bar_is_judged_by_its_bounds_alone(bar, word):
    episodes = [Episode(task="t", score=float(i % 5 > 0), start=str(i)) for i in range(200)]
    new = Evaluation(name="n", score="success", episodes=tuple(episodes))
    assert judge(new, limits=JudgeSettings(bar=bar)).word == word


def test_the_judgement_is_printed_as_a_table_or_as_json(tmp_path, capsys):
    path = str(csv(tmp_path / "a.csv", [("t", i, i % 4 > 0) for i in range(300)]))
    with pytest.raises(SystemExit) as left:
        main(["judge", path, "--baseline", path, "--json"])
    told = json.loads(capsys.readouterr().out)
    assert (left.value.code, told["word"], told["candidate"]) == (0, "PASS", 0.75)
    with pytest.raises(SystemExit):
        main(["judge", path, "--baseline", path])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "PASS"
    assert lines[-1].split() == ["mean", "0.750", "0.750"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--max-drop", "0"], "max_drop 0 do not fit"),
        (["--tolerate", "0.2"], "tolerate 0.2 and max_drop 0.1 do not fit"),
        (["--confidence", "1"], "confidence 1 and false_alarm"),
        (["--range", "5,1"], "--range '5,1' is not a range"),
        ([], "nothing to judge by; name a baseline or a bar"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, said, tmp_path, capsys):
    path = str(csv(tmp_path / "a.csv"))
    baseline = ["--baseline", path] if options else []
    with pytest.raises(SystemExit) as left:
        main(["judge", path, *baseline, *options])
    assert left.value.code == 2
    assert said in capsys.readouterr().err
