"""The page in a real browser: nothing is complained of, nothing asked for, and all can read it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("websockets")

from nw_eval.reporting.html.runs import ListedRun, render_index
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import combined

sys.path.insert(0, str(Path(__file__).parent))

from browser import CHROMIUM, browser

AXE = "axe-core@4.10.3"

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")


@pytest.fixture(scope="module")
def tab():
    with browser() as found:
        yield found


@pytest.fixture(params=[150])
def page(request, make_page, make_row, full_evidence, compared, tmp_path):
    """A page with all that one can have: a baseline, many outcomes, paths, pictures and clips."""
    rows = [
        make_row(
            f"hurdles/{scene}", index, index % 5,
            **({} if index % 5 == 4 else {"outcome": outcome}),
        )
        for scene in ("low", "high")
        for index, outcome in enumerate(("fell", "collided", "stuck", "off_course", "timeout") * 30)
        if index < request.param
    ]  # fmt: skip
    path = tmp_path / "report.html"
    path.write_text(make_page(rows, full_evidence(rows), against=compared), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def axe(tmp_path_factory):
    """The source of axe-core, from npm."""
    npm, folder = shutil.which("npm"), tmp_path_factory.mktemp("axe")
    if npm is None:
        pytest.skip("needs npm")
    words = [npm, "install", "--ignore-scripts", "--no-audit", "--no-fund", AXE]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"npm has no {AXE}: {done.stderr[-200:]}")
    return (folder / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


def test_a_browser_has_nothing_to_complain_of_and_asks_for_nothing(tab, page):
    tab.show(page)
    assert tab.complaints == []
    assert tab.requests == [page.as_uri()]
    # Trials are found, sorted and shown in parts.
    assert tab.run("document.querySelector('.count').textContent") == "300 of 300 trials, 200 shown"
    choose = (
        "((words, outcome) => { const form = document.querySelector('form.filter');"
        "form.words.value = words; form.outcome.value = outcome;"
        "form.dispatchEvent(new Event('input')); })"
    )
    tab.run(f"{choose}('high-00', 'fell')")
    assert tab.run("document.querySelector('.count').textContent") == "2 of 300 trials"
    tab.run(f"{choose}('high-00', '')")
    tab.run("document.querySelector('#all th:nth-child(5) button').click()")
    shown = "[...document.querySelectorAll('#all tbody tr')].filter((row) => !row.hidden)"
    reached = tab.run(f"{shown}.map((row) => Number(row.cells[4].textContent[0]))")
    assert reached == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert tab.run("document.querySelector('#all [aria-sort]').textContent") == "waypoints"
    assert tab.complaints == []


def test_a_trial_opens_over_the_page_and_escape_closes_it(tab, page):
    tab.show(page)
    open_ = "[...document.querySelectorAll('.sheet')].filter((each) => each.offsetHeight > 0)"
    line = "document.querySelector('#all tbody tr:nth-child(100) th')"
    drawn = "new Promise((drawn) => setTimeout(drawn, 300))"
    assert tab.run(f"{open_}.length") == 0
    tab.run(f"{line}.querySelector('a').click()")
    tab.run(drawn)
    name = tab.run(f"{line}.textContent")
    assert tab.run(f"{open_}.map((each) => each.querySelector('h3').textContent.trim())") == [name]
    tab.run("dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
    tab.run(drawn)
    assert tab.run(f"{open_}.length") == 0
    # One of the worst has a card, which may be folded.
    card = "document.querySelector('details.more-worst li')"
    tab.run(f"void (location.hash = '#' + {card}.id)")
    tab.run(drawn)
    assert tab.run(f"{card}.offsetHeight") > 0
    assert tab.complaints == []


def test_the_count_of_an_outcome_filters_the_table(tab, page):
    tab.show(page)
    link = "document.querySelector('a[data-outcome=stuck]')"
    tab.run(f"{link}.click()")
    assert tab.run("document.querySelector('form.filter').outcome.value") == "stuck"
    count = tab.run(f"{link}.textContent").removeprefix("stuck (").removesuffix(")")
    found = tab.run("document.querySelector('.count').textContent")
    assert found == f"{count} of 300 trials"
    tab.run("document.querySelector('.heat a[data-scene]').click()")
    assert tab.run("document.querySelector('form.filter').outcome.value") == ""
    found = tab.run("document.querySelector('.count').textContent")
    assert found == "150 of 300 trials"


def test_a_stranger_s_script_would_not_run_even_in_the_page(tab, page):
    """Should escaping ever fail, the page's own policy is the second fence."""
    text = page.read_text(encoding="utf-8")
    held = "<script>document.title = 'owned'</script><img src='http://127.0.0.1:9/x'>"
    page.write_text(text.replace("<footer>", f"{held}<footer>"), encoding="utf-8")
    tab.show(page)
    assert tab.run("document.title").startswith(("PASS", "REGRESSED", "INCONCLUSIVE"))
    assert sum("Content Security Policy" in line for line in tab.complaints) == 2


@pytest.fixture
def index_page(make_run, make_row, compared, tmp_path):
    """A page over two runs, one of which cannot be read."""
    rows = [make_row("hurdles/high", index, index % 5) for index in range(20)]
    verdict = combined(judge(rows, Gate(), {"hurdles/high": 20}, against=compared), compared)
    runs = [
        ListedRun(
            folder=name, href=href, info=make_run({"hurdles/high": 20}, id=name), verdict=verdict
        )
        for name, href in (("one", "one/report.html"), ("two", None))
    ]
    path = tmp_path / "index.html"
    path.write_text(render_index(runs, ["three: damaged"]), encoding="utf-8")
    return path


def test_two_runs_of_an_index_stand_side_by_side_and_runs_are_filtered(tab, index_page):
    tab.show(index_page)
    heads = "[...document.querySelectorAll('[data-compares] thead > tr > *')]"
    shown = f"{heads}.filter((head) => !head.hidden).map((head) => head.innerText.split(/\\s/)[0])"
    assert len(tab.run(shown)) == 5, "the scene, a drawing, the last change, and two runs"
    pick = (
        "((form) => { form.second.selectedIndex = 1; form.dispatchEvent(new Event('input')); })"
        "(document.querySelector('form.pick'))"
    )
    tab.run(pick)
    assert tab.run(shown)[-1] == "change"
    changes = "[...document.querySelectorAll('td.change')].map((cell) => cell.textContent)"
    assert tab.run(changes) == ["0.000", "0.000"]
    find = (
        "((form) => { form.words.value = 'two'; form.dispatchEvent(new Event('input')); })"
        "(document.querySelector('form.filter'))"
    )
    tab.run(find)
    assert tab.run("document.querySelector('.count').textContent") == "1 of 2 runs"
    assert tab.complaints == []


@pytest.mark.nightly
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390], ids=["desktop", "phone"])
@pytest.mark.parametrize("shown", ["page", "index_page"])
@pytest.mark.parametrize("page", [10], indirect=True, ids=["small"])
def test_axe_finds_nothing_serious(tab, axe, page, index_page, shown, width, dark):
    path = page if shown == "page" else index_page
    tab.show(path, width=width, dark=dark)
    assert tab.complaints == []
    assert tab.requests == [path.as_uri()]
    # No part of the page is wider than the screen: what is wide scrolls within itself.
    assert tab.run("document.documentElement.scrollWidth") == width
    tab.run(f"{axe}; 0")
    found = json.loads(tab.run("axe.run().then((found) => JSON.stringify(found.violations))"))
    serious = [each for each in found if each["impact"] in {"serious", "critical"}]
    assert [(each["id"], [node["html"] for node in each["nodes"][:3]]) for each in serious] == []
