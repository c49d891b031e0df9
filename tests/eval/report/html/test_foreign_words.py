"""Names and texts of strangers: a page shows them, and none of them becomes a part of it."""

import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest

from nw_eval.reporting.html.evidence import Clip, LogEvidence, PlaceView, WalkedPath
from nw_eval.reporting.html.runs import ListedRun, render_index
from nw_gate.results.provenance import PolicyInfo

NASTY = (
    "</title></script></style><script>alert(1)</script>\"' onload='x' <img src=http://evil/x>\n"
    "\x1b[2J\u202etxt\u2066 ws://bob:hunter2@host/x {{ 7 * 7 }} &amp; --> ]]>"
)
VISIBLE = "\\u202etxt\\u2066 ws://host/x {{ 7 * 7 }} &amp; --> ]]>"


@pytest.fixture
def nasty_page(make_page, make_row):
    failed = {"outcome": "policy_failed", "end_reason": "exception", "error_text": NASTY}
    rows = [
        make_row(NASTY, 0, 1, trial_id=f"{NASTY}-0", end_reason=NASTY, mcap_path="mcap/a.mcap"),
        make_row(NASTY, 1, 2, trial_id=f"{NASTY}-1", **failed),
        make_row(NASTY, 2, None, trial_id=f"{NASTY}-2", error_text=NASTY),
    ]
    name = rows[0].trial_id
    evidence = LogEvidence(
        paths=(WalkedPath(trial_id=name, points=np.zeros((2, 2))),),
        places=(PlaceView(scene=rows[0].scene, waypoints=np.zeros((1, 2))),),
        clips=(
            Clip(
                trial_id=name, mime="image/webp", data=b"x", width=8, height=8, seconds=1.0,
                caption=NASTY,
            ),
        ),
        remarks=(NASTY,),
    )  # fmt: skip
    policy = PolicyInfo(name=NASTY, checkpoint_digest=NASTY)
    return make_page(
        rows, evidence, id=NASTY, suite={"name": NASTY}, suite_file=NASTY, policy=policy
    )


def check_harmless(page, read):
    for mark in ("\x1b", "\u202e", "\u2066", "hunter2"):
        assert mark not in page
    parsed = read(page)
    # One script and one style sheet are ours, and no element came from a name.
    assert len(parsed.all("script")) == len(parsed.all("style")) == 1
    assert len(parsed.one("head").all("title")) == 1
    assert len(parsed.all("img")) <= 1
    for element in parsed.all():
        assert not any(name.startswith("on") for name in element.attributes)
        for name in ("src", "href"):
            where = element.attributes.get(name) or "#"
            assert re.match(r"#|data:|[\w.%/-]+$", where), where


def test_every_surface_of_the_page_shows_them_as_text(nasty_page, read):
    check_harmless(nasty_page, read)
    page = read(nasty_page)
    places = [
        page.one("head").one("title"),
        page.one("p", class_="what"),
        page.one("section", id="scenes"),
        page.one("table", class_="heat"),
        page.one("figure", class_="view").one("figcaption"),
        page.one("section", id="worst").one("p", class_="caption"),
        page.one("section", id="worst").one("p", class_="note"),
        page.one("section", id="outcomes"),
        page.one("section", id="provenance"),
        page.one("table", id="all"),
        page.one("form").one("select", name="scene"),
        page.one("footer"),
    ]
    for place in places:
        assert VISIBLE in place.text, place.tag
    assert VISIBLE in page.one("section", id="worst").one("img").attributes["alt"]


def test_the_page_over_many_runs_shows_them_as_text(make_run, make_row, read):
    from nw_eval.suite import Gate
    from nw_gate.absolute import judge

    run = make_run({NASTY: 1}, id=NASTY, started=NASTY, suite={"name": NASTY})
    verdict = judge([make_row(NASTY, 0, 4)], Gate(), {NASTY: 1})
    listed = ListedRun(folder="x", href="x/report.html", info=run, verdict=verdict)
    page = render_index([listed, replace(listed, href=None)], [NASTY])
    check_harmless(page, read)
    assert VISIBLE in read(page).one("section", id="suite-1").text


def test_the_page_forbids_itself_all_but_its_own_script_and_style(nasty_page, read):
    page = read(nasty_page)
    policy = page.one("meta", http_equiv="Content-Security-Policy").attributes["content"]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for name in ("script", "style"):
        (text,) = re.findall(rf"<{name}>(.*?)</{name}>", nasty_page, re.DOTALL)
        digest = b64encode(sha256(text.encode()).digest()).decode()
        assert rules[f"{name}-src"] == f"'sha256-{digest}'"
    assert not [each for each in page.all() if "style" in each.attributes]
