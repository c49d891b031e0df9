"""Where pages are written, and what becomes of a run when they cannot be."""

import os
import re
from pathlib import Path

import pytest
from command_line import ends

from nw_eval import api


@pytest.fixture(autouse=True)
def _somewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_run_gets_a_page_for_the_browser_beside_the_markdown(save_run, capsys):
    save_run(Path("runs/one"), [4] * 20)
    assert ends("report", "runs/one") == 0
    assert capsys.readouterr().out.endswith("report: runs/one/report.md and report.html\n")
    page = Path("runs/one/report.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    assert "<title>PASS · hurdles · go1-parkour</title>" in page


@pytest.mark.parametrize(
    ("out", "markdown", "html"),
    [
        ("page.md", "page.md", "page.html"),
        ("page.html", "page.md", "page.html"),
        ("v1.2", "v1.2", "v1.2.html"),
    ],
)
def test_either_page_may_be_named_and_the_other_one_lies_beside_it(save_run, out, markdown, html):
    judged = api.report(save_run(Path("one"), [4] * 20), out=Path(out))
    assert (judged.page, judged.html) == (Path(markdown), Path(html))
    assert Path(markdown).read_text(encoding="utf-8").startswith("# PASS")
    assert Path(html).read_text(encoding="utf-8").startswith("<!doctype html>")
    assert not Path("one/report.html").exists()


def test_a_page_that_cannot_be_written_is_an_error_and_the_rows_stay(save_run, capsys):
    run = save_run(Path("one"), [4] * 20)
    (run / "report.html").mkdir()
    before = (run / "trials.parquet").read_bytes()
    assert ends("report", "one") == 4
    error = capsys.readouterr().err
    assert re.fullmatch(r"error: cannot write \S*report\.html: it is a folder; .+\n", error)
    assert (run / "trials.parquet").read_bytes() == before
    assert len(api.judge(run).rows) == 20


@pytest.mark.parametrize("verb", ["report", "gate"])
def test_a_pipe_in_place_of_the_rows_file_does_not_hold_up_a_report(save_run, capsys, verb):
    run = save_run(Path("one"), [4] * 20)
    (run / "trials.parquet").unlink()
    os.mkfifo(run / "trials.parquet")
    assert ends(verb, "one") == 0
    assert "judged from the journal" in "".join(capsys.readouterr())
    assert (run / "trials.parquet").is_fifo()


def test_the_page_is_opened_in_the_readers_browser(save_run, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: bool(opened.append(address)))
    run = save_run(Path("one"), [0] * 20)
    assert ends("report", "one", "--open") == 1
    assert opened == [(run / "report.html").resolve().as_uri()]
    # Here it opened nothing: that is said, and changes no verdict.
    assert capsys.readouterr().err == (
        f"warning: no browser to open here; the page is {opened[0]}\n"
    )


def test_many_runs_get_one_page_with_trends_by_scene(save_run, read, capsys):
    save_run(Path("runs/new"), [2] * 20, started="2026-11-22T11:00:05Z")
    save_run(Path("runs/old"), [4] * 20)
    api.report(Path("runs/old"))
    assert ends("report", "runs/new", "runs/old", "runs/old") == 0
    assert capsys.readouterr().out == "index of 2 runs: runs/index.html\n"
    assert not Path("runs/new/report.html").exists()
    page = read(Path("runs/index.html").read_text(encoding="utf-8"))
    runs, trends = page.all("table")
    digest = r" [0-9a-f]{8}(?= )"
    found = [[re.sub(digest, "", line[0]), *line[2:4]] for line in runs.cells[1:]]
    assert all(re.search(digest, line[0]) for line in runs.cells[1:])
    assert found == [
        ["go1-parkour new", "INCONCLUSIVE", "0.500"],
        ["go1-parkour old", "PASS", "1.000"],
    ]
    links = [str(each.attributes["href"]) for each in runs.all("a")]
    assert [re.sub(r"-[0-9a-f]{8}\.html", "", link) for link in links] == [
        "index-runs/new",
        "index-runs/old",
    ]
    old = read((Path("runs") / links[1]).read_text(encoding="utf-8"))
    assert "PASS" in old.one("h1").text
    # The oldest first, and named as one knows them.
    assert [[line[0], *line[2:]] for line in trends.cells] == [
        ["scene", "go1-parkour last change", "go1-parkour old", "go1-parkour new"],
        ["all scenes", "-0.500", "1.000", "0.500"],
        ["a", "-0.500", "1.000", "0.500"],
    ]


def test_a_damaged_run_is_named_on_the_page_of_many_and_costs_the_others_nothing(
    save_run, read, capsys
):
    save_run(Path("good"), [4] * 20)
    save_run(Path("bad"), [4] * 20)
    Path("bad/run.json").write_text("{", encoding="utf-8")
    assert ends("report", "good", "bad", "--out", "list.html") == 4
    assert "warning: not read: bad: " in capsys.readouterr().err
    page = read(Path("list.html").read_text(encoding="utf-8"))
    assert page.one("h1").text == "1 run"
    assert "run.json is damaged" in page.one("header").one("li").text


def test_what_is_no_run_is_a_mistake_of_whoever_typed_it(save_run, capsys):
    save_run(Path("one"), [4] * 20)
    assert ends("report", "one", "elsewhere") == 2
    assert "elsewhere is not the folder of a run" in capsys.readouterr().err
    assert not Path("index.html").exists()
    assert ends("report") == 2
    assert ends("report", "one", "one", "--junit", "x.xml") == 2
