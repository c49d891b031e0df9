"""Runs that somebody else made: their pages are written anew, and nothing of their folder leaks."""

import json
import os
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from saved_runs import info_of, save
from saved_runs import row_of as plain_row

import nw_eval
from nw_eval.api.saved_run import saved_suite, saved_trials
from nw_eval.suite import new_suite
from nw_gate.results.labels import KNOWN
from nw_gate.results.provenance import (
    BaselineInfo,
    CacheInfo,
    CodeInfo,
    MachineInfo,
    PolicyInfo,
    SceneInfo,
    read_run_info,
)
from nw_gate.results.run_folder import RunFolder
from nw_gate.results.seal import seal

EVIL = (
    "</script><script>alert('owned')</script><img src=x onerror=alert(1)>\"' onload='owned()' "
    "</style><svg/onload=owned()>{{7*7}}<!--]]>--!><a href=javascript:owned()>x</a>\u202e\x00"
)
SECRET = "root:x:0:0:what lies outside"
EVIL_LABEL = "</td><script>alert('owned')</script>\"' onload='owned()' javascript:owned()"
TEMPLATES = Path(nw_eval.__file__).parent / "reporting/templates"
TRIALS = 12


def save_run(path, *, evil="", success=True, **facts):
    """Save a run that has ended and is consistent, with a text in all fields that take one."""
    # No scene's name has a backslash, which is what `clean` makes of what cannot be seen.
    scene = f"room/{evil.replace(chr(0), '').replace(chr(0x202E), '')}" if evil else "flat/room"
    settings = {"name": "tiny", "robot": "go1", "policy": evil or "stand", "scenes": [scene]}
    gate = {"success_rate": 0.5, "tiers": {"room/*": "critical"}} if evil else {}
    suite = new_suite({"nw-eval": 1, "trials": TRIALS, "seed": 7, **settings, "gate": gate})
    says = {
        "id": evil or path.name,
        "started": evil or "2026-11-21T11:00:05Z",
        "finished": evil or "2026-11-21T11:01:05Z",
        "suite_file": evil or "tiny.yaml",
        "suite_folder": evil,
        "renderer": evil,
        "fence": evil,
        "command": (evil, "--x"),
        "versions": {evil or "mujoco": evil or "4.0.0"},
        "engine": {evil or "mujoco": evil or "4.0.0"},
        "cache": CacheInfo(off=evil, differing=(evil,) if evil else ()),
        "labels": {name: EVIL_LABEL for name in KNOWN if evil and name != "job_url"},
        **facts,
    }
    policy = {"name": evil or "stand", "adapter": evil, "card_digest": evil, "card": evil}
    code = {"version": evil or "0.1.0", "digest": evil or "ee" * 32, "commit": evil}
    machine = {"host": evil or "ci", "cpu": evil or "Some", "cores": 2, "system": evil or "x"}
    info = info_of(
        suite,
        {scene: SceneInfo(digest=evil or "dd" * 32, task=evil or "flat", trials=TRIALS)},
        policy=PolicyInfo(**policy, checkpoint_digest=evil or "cc" * 32, origin=evil),
        code=CodeInfo(**code),
        machine=MachineInfo(**machine, python=evil or "3"),
        **says,
    )
    rows = [
        row_of(trial, info, evil, completed=success and k % 3 > 0, failed=bool(evil) and k % 3 == 1)
        for k, trial in enumerate(saved_trials(info, saved_suite(info)))
    ]
    return save(path, info, rows)


def row_of(trial, info, evil, *, completed, failed):
    error = {"end_reason": "", "error_type": evil, "error_text": evil}
    return plain_row(
        trial,
        None if failed else 4 if completed else 1,
        policy=info.policy.name,
        checkpoint_digest=info.policy.checkpoint_digest,
        **(error if failed else {"end_reason": evil or "waypoints"}),
    )


class Parts(HTMLParser):
    """The elements of a page, and what stands in its scripts and styles."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags = set()
        self.attributes = []
        self.raw = {"script": [], "style": []}
        self.others = []
        self._open = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag in self.raw:
            self.raw[tag].append("")
            self._open = tag

    def handle_endtag(self, tag):
        self._open = "" if tag == self._open else self._open

    def handle_data(self, data):
        if self._open:
            self.raw[self._open][-1] += data

    def handle_comment(self, data):
        self.others.append(data)

    def unknown_decl(self, data):
        self.others.append(data)

    def handle_pi(self, data):
        self.others.append(data)


# Those of the templates, and no more: no iframe, object, embed, base, link but the icon's, a form
# that goes nowhere.
NAMES = """
html head meta link title style body a g header h1 h2 h3 p span ul li nav main section
div table caption thead tbody tr th td svg defs symbol path circle rect text polygon
image use figure figcaption strong small code em label form input select option
button img details summary footer script
"""
ELEMENTS = set(NAMES.split())


def check_page(path):
    """Fail if a page holds anything but nw-eval's own script, style, elements and addresses."""
    text = path.read_text(encoding="utf-8")
    assert SECRET not in text
    parts = Parts(text)
    assert parts.tags <= ELEMENTS
    script, style = ((TEMPLATES / f"page.{kind}").read_text() for kind in ("js", "css"))
    assert parts.raw == {"script": [script], "style": [style]}
    assert parts.others == []
    for tag, name, value in parts.attributes:
        assert not name.startswith("on"), (tag, name, value)
        assert name not in {"style", "srcset", "srcdoc", "formaction", "ping", "xlink:href"}
        if name in {"href", "src", "action"}:
            is_own = value.startswith(("#", "data:,", "http://localhost:8720/?"))
            is_picture = tag in {"img", "image"} and value.startswith("data:image/")
            is_page = tag == "a" and value.endswith(".html") and ".." not in value
            is_page = is_page and (path.parent / value).is_file()
            assert is_own or is_picture or is_page, (tag, name, value)
    (policy,) = [value for _, name, value in parts.attributes if value.startswith("default-src")]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")


def pages_of(runs, folder):
    """Write the site and the index of runs; return their pages, once looked at, and who is out."""
    site = nw_eval.write_site(runs, folder / "site", pictures=False)
    index = nw_eval.index_runs(runs, out=folder / "list" / "index.html")
    pages = sorted((folder / "site").rglob("*.*")) + sorted((folder / "list").rglob("*.*"))
    assert {page.name for page in pages if page.suffix != ".html"} == {
        *("site.json", "badge.json", "badge-tiny.json")
    }
    pages = [page for page in pages if page.suffix == ".html"]
    for page in pages:
        assert page.is_file()
        assert not page.is_symlink()
        check_page(page)
    assert sorted(name.partition(":")[0] for name in site.left_out) == sorted(
        name.partition(":")[0] for name in index.unread
    )
    return pages, [*site.left_out]


@pytest.fixture
def outside(tmp_path):
    """A file of this machine that is nobody's business."""
    path = tmp_path / "outside" / "passwd"
    path.parent.mkdir()
    path.write_text(SECRET)
    return path


@pytest.fixture
def honest(tmp_path):
    return save_run(tmp_path / "runs" / "honest").path


def test_words_of_a_strangers_run_are_text_on_every_page(tmp_path, honest):
    folder = save_run(tmp_path / "runs" / "evil", evil=EVIL)
    cause = {
        "answer": "perception",
        "sentences": [EVIL],
    }
    folder.report_html.write_text(EVIL)
    folder.report_md.write_text(EVIL)
    (folder.path / "index.html").write_text(EVIL)
    pages, left_out = pages_of([folder.path, honest], tmp_path)
    assert left_out == []
    assert len(pages) == 7
    shown = [page for page in pages if "alert(" in page.read_text(encoding="utf-8")]
    assert len(shown) == 5, "the site's two pages, the index, a page of the run in either folder"
    folder.cause.write_text(json.dumps(cause))
    _, left_out = pages_of([folder.path, honest], tmp_path)
    assert "cause.json is damaged" in left_out[0]


def test_a_page_that_a_run_brings_is_not_published(tmp_path, honest, outside):
    other = save_run(tmp_path / "runs" / "other", success=False)
    RunFolder(path=honest).report_html.write_text("<script>owned()</script>")
    other.report_html.symlink_to(outside)
    other.report_md.symlink_to(outside)
    os.mkfifo(other.workers_log)
    pages, left_out = pages_of([honest, other.path], tmp_path)
    assert left_out == []
    assert len(pages) == 7


def link(path, outside):
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    path.symlink_to(outside)


def change_rows(folder, change):
    """Have a run with other rows, which is as consistent as before."""
    info = read_run_info(folder.run_json)
    trials = saved_trials(info, saved_suite(info))
    rows = [
        row_of(trial, info, "", completed=k % 3 > 0, failed=False) for k, trial in enumerate(trials)
    ]
    for file in (folder.journal, folder.trials, folder.digests, folder.run_json):
        file.unlink()
    info = info.model_copy(update={"rows_digest": ""})
    again = save(folder.path / "again", info, [change(k, row) for k, row in enumerate(rows)])
    for file in again.path.iterdir():
        file.rename(folder.path / file.name)
    again.path.rmdir()


def name_log(folder, path):
    """Have a run whose first row names a log at a path, and has its digest."""
    log = {"mcap_path": path, "mcap_sha256": "ab" * 32, "mcap_bytes": 3}
    change_rows(folder, lambda k, row: row if k else replace(row, **log))


HOSTILE = {
    "a link for run.json": (
        lambda run, out: (
            run.run_json.rename(out.with_name("r")),
            link(run.run_json, out.with_name("r")),
        ),
        "run.json is a symbolic link",
    ),
    "a link for rows": (
        lambda run, out: link(run.journal, out),
        "journal.jsonl is a symbolic link",
    ),
    "a link for the table": (
        lambda run, out: link(run.trials, out),
        "trials.parquet is a symbolic link",
    ),
    "a link for the digests": (
        lambda run, out: link(run.digests, out),
        "digests.json is a symbolic link",
    ),
    "a link for the cause": (
        lambda run, out: link(run.cause, out),
        "cause.json is a symbolic link",
    ),
    "a link for the logs": (
        lambda run, out: link(run.logs, out.parent),
        "mcap is a symbolic link",
    ),
    "a link for a baseline": (
        lambda run, out: link(run.baseline_file("tiny"), out),
        "bank/tiny.parquet is a symbolic link",
    ),
    "a link among the logs": (
        lambda run, out: (run.logs.mkdir(), link(run.logs / "a" / "b.mcap", out)),
        "mcap/a/b.mcap is a symbolic link",
    ),
    "a hard link": (
        lambda run, out: run.cause.hardlink_to(out),
        "cause.json is a hard link",
    ),
    "a pipe": (lambda run, _: os.mkfifo(run.cause), "cause.json is not a plain file"),
    "a pipe for rows": (
        lambda run, _: (run.journal.unlink(), os.mkfifo(run.journal)),
        "journal.jsonl is not a plain file",
    ),
    "a pipe among the logs": (
        lambda run, _: (run.logs.mkdir(), os.mkfifo(run.logs / "x.mcap")),
        "mcap/x.mcap is not a plain file",
    ),
    "a folder for rows": (
        lambda run, _: (run.trials.unlink(), run.trials.mkdir()),
        "trials.parquet is not a plain file",
    ),
    "a log of a terabyte": (
        lambda run, _: (run.logs.mkdir(), os.truncate(_made(run.logs / "x.mcap"), 2**40)),
        "over 500,000 files or 16 GiB",
    ),
    "a journal of gigabytes": (
        lambda run, _: os.truncate(run.journal, 2**32),
        "journal.jsonl is unreadable",
    ),
    "a run.json of 20 MB": (
        lambda run, _: rewritten(run, {"command": ["x" * 20_000_000]}),
        "run.json is damaged: it has 19 MiB, over 16",
    ),
    "a cause of 2 MB": (
        lambda run, _: run.cause.write_text("[" * 2_000_000),
        "cause.json is damaged",
    ),
    "no number": (lambda run, _: rewritten(run, {"wall_s": float("nan")}), "run.json is damaged"),
    "a word for a number": (lambda run, _: rewritten(run, {"workers": EVIL}), "workers: input"),
    "a list for a name": (lambda run, _: rewritten(run, {"id": [EVIL]}), "run.json is damaged"),
    "a list for all": (lambda run, _: run.run_json.write_text("[1]"), "run.json is damaged"),
    "brackets": (lambda run, _: run.run_json.write_text("[" * 10**6), "run.json is damaged"),
    "a name with dots": (
        lambda run, out: rewritten(
            run,
            {"baseline": {"name": "../../outside/passwd", "path": str(out), "sha256": "00" * 32}},
        ),
        "run.json is changed",
    ),
    "another policy's name": (
        lambda run, _: rewritten(run, {"policy": {"name": "x", "checkpoint_digest": "c" * 64}}),
        "run.json is changed",
    ),
    "a changed row": (
        lambda run, _: run.journal.write_bytes(
            run.journal.read_bytes().replace(b'"success":0.25', b'"success":1.00')
        ),
        "journal.jsonl is unreadable",
    ),
    "no digests": (lambda run, _: run.digests.unlink(), "digests.json is missing"),
    "no table": (lambda run, _: run.trials.unlink(), "trials.parquet is unreadable"),
    "a log that no row names": (
        lambda run, _: (run.logs.mkdir(), (run.logs / "x.mcap").write_text("x")),
        "mcap/x.mcap is extra",
    ),
    "a log elsewhere": (
        lambda run, _: name_log(run, "../../outside/passwd"),
        "../../outside/passwd (flat-room-000) is unreadable",
    ),
    "four million waypoints": (
        lambda run, _: change_rows(run, lambda _, row: replace(row, waypoints_total=4 * 10**6)),
        "trial flat-room-000 has 4000000 waypoints",
    ),
    "a log with another content": (
        lambda run, _: (
            name_log(run, "mcap/a.mcap"),
            run.logs.mkdir(),
            (run.logs / "a.mcap").write_text("abc"),
        ),
        "mcap/a.mcap (flat-room-000) is changed",
    ),
}


def _made(path):
    path.touch()
    return path


def rewritten(run, changes):
    """Change run.json, and give it the checksum that it is to have."""
    record = json.loads(run.run_json.read_text())
    del record["sum"]
    run.run_json.write_text(seal(json.dumps(record | changes))[0])


def test_a_run_that_is_not_consistent_or_leads_elsewhere_is_named_and_costs_no_other(
    tmp_path, honest, outside
):
    folders = {name: save_run(tmp_path / "runs" / name.replace(" ", "-")) for name in HOSTILE}
    for name, (harm, _) in HOSTILE.items():
        harm(folders[name], outside)
    runs = [folder.path for folder in folders.values()]
    before = {path: path.lstat().st_mtime_ns for run in runs for path in run.rglob("*")}
    pages, left_out = pages_of([*runs, honest], tmp_path)
    assert len(pages) == 5, "the site's two pages, the index, the honest run's page in either"
    why = {sentence.partition(": ")[0]: sentence.partition(": ")[2] for sentence in left_out}
    wrong = {
        name: why.get(folder.path.name, "")
        for name, folder in folders.items()
        if HOSTILE[name][1] not in why.get(folder.path.name, "")
    }
    assert wrong == {}
    assert outside.read_text() == SECRET
    after = {path: path.lstat().st_mtime_ns for run in runs for path in run.rglob("*")}
    assert after == before, "nothing is written into a stranger's folder"


def test_runs_that_have_no_comparison_stand_alone(tmp_path, honest):
    name = "<img src=x onerror=alert(1)>\n::error::x\u202e"
    folder = save_run(tmp_path / "runs" / name)
    change_rows(folder, lambda _, row: replace(row, perturbation=(("<script>", 1.0),)))
    pages, left_out = pages_of([honest, folder.path], tmp_path)
    assert (len(pages), left_out) == (7, [])
    site = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert "tiny (1)" in site
    assert "tiny (2)" in site


def test_a_run_that_is_whole_but_for_its_logs_is_shown(tmp_path, honest):
    folder = save_run(tmp_path / "runs" / "bare")
    name_log(folder, "mcap/flat/a.mcap")
    pages, left_out = pages_of([honest, folder.path], tmp_path)
    assert (len(pages), left_out) == (7, [])


def test_a_baseline_is_read_from_the_runs_folder_alone(tmp_path, outside):
    baseline = BaselineInfo(name="tiny", path=str(outside), sha256=_sha256(outside))
    folder = save_run(tmp_path / "runs" / "against", baseline=baseline)
    pages, left_out = pages_of([folder.path], tmp_path)
    assert left_out == []
    assert all("INVALID" in page.read_text(encoding="utf-8") for page in pages)


def _sha256(path):
    from hashlib import sha256

    return sha256(path.read_bytes()).hexdigest()


def test_ten_megabytes_of_words_make_no_page_of_ten_megabytes(tmp_path, honest):
    long = "<b>" * 1_000_000
    folder = save_run(tmp_path / "runs" / "long", renderer=long, command=(long,), id=long)
    assert folder.run_json.stat().st_size > 9_000_000
    pages, left_out = pages_of([folder.path, honest], tmp_path)
    assert (len(pages), left_out) == (7, [])
    assert max(page.stat().st_size for page in pages) < 400_000
