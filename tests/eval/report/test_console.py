from io import StringIO
from pathlib import Path
from typing import get_args

from rich.console import Console

from nw_eval.reporting.console import _COLOURS, print_summary
from nw_eval.reporting.headline import headline
from nw_eval.reporting.tables.trials import worst_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.verdict import EXIT_CODES, Word

BAR = Gate(success_rate=0.75)


def summary(rows, run, width=100, gate=BAR):
    console = Console(file=StringIO(), width=width)
    verdict = judge(rows, gate, run.planned)
    print_summary(console, run, rows, verdict, Path("reports/r"))
    return console.file.getvalue().splitlines()


def test_the_summary_ends_with_the_reports_first_lines(make_row, make_run):
    rows = [make_row("a", k, 4) for k in range(20)]
    run = make_run({"a": 20})
    lines = summary(rows, run, width=200)
    verdict = judge(rows, Gate(success_rate=0.75), run.planned)
    assert lines[-3] == headline(verdict, run)
    assert lines[-2].startswith("The bounds apply to new initial states in these scenes.")
    assert lines[-1].startswith("* success is at least")


def test_a_replay_command_is_one_whole_line_however_narrow_the_terminal(make_row, make_run):
    lines = summary([make_row("hurdles/one", 0, 1)], make_run({"hurdles/one": 1}), width=40)
    assert "nw-eval replay reports/r/mcap/hurdles/one/hurdles-one-000.mcap" in lines


def test_a_table_of_hundreds_of_scenes_shows_the_worst_and_says_how_many_more_there_are(
    make_row, make_run
):
    names = [f"place/{number:02d}" for number in range(70)]
    rows = [make_row(name, 0, 0 if name == "place/69" else 4) for name in names]
    lines = summary(rows, make_run(dict.fromkeys(names, 1)))
    shown = [line for line in lines if line.lstrip().startswith("place/")]
    assert shown[0].lstrip().startswith("place/69")
    assert sum(" 1 of 1 " in line or " 0 of 1 " in line for line in shown) == 64
    assert "6 more lines in the report" in lines


def test_brackets_in_an_error_are_text_not_markup(make_row, make_run):
    rows = [make_row("a", 0, None, error_text="bad key [bold]x[/nothing]")]
    assert any("[bold]x[/nothing]" in line for line in summary(rows, make_run({"a": 1}), 200))


def test_a_suite_without_a_bar_ends_with_the_word_ran_and_never_with_pass(make_row, make_run):
    rows = [make_row("a", k, 0) for k in range(4)]
    lines = summary(rows, make_run({"a": 4}), 200, Gate())
    first = "RAN · completed 0 of 4 trials in 1 scene · success 0.000 (not judged) "
    assert lines[-3].startswith(first)
    assert lines[-1] == "* 4 trials ran and nothing was judged: the suite sets no gate.success_rate"
    assert not any("PASS" in line for line in lines)


def test_every_word_of_the_gate_has_a_colour_and_an_exit_code():
    assert set(_COLOURS) == set(EXIT_CODES) == set(get_args(Word))


def test_a_task_without_waypoints_shows_success_in_place_of_waypoints(make_row):
    row = make_row(
        "flat/a", 0, 1, task_kind="reach", waypoints_reached=0, waypoints_total=0, waypoint_times=()
    )
    (line,) = worst_table([row], Path("run")).rows
    assert line[1] == "0.25"
