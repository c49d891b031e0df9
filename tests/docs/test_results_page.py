"""The reference of results names all that a run leaves: ends, files, columns, exit codes."""

import re
import signal
import tomllib
from pathlib import Path

import pytest

from nw_base.confinement import family
from nw_base.errors import UsageError
from nw_base.words import FAULTS, OUTCOMES, POLICY_FAULTS
from nw_eval.engine import machine
from nw_gate.results.parquet import SCHEMA
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import MEASURED, OF_THE_PLAN
from nw_gate.results.run_folder import RunFolder
from nw_gate.verdict import EXIT_CODES
from nw_sim.rollout.episode import HUGE

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"
PAGE = "\n".join(
    (REFERENCE / f"{name}.md").read_text(encoding="utf-8")
    for name in ("outcomes", "run-folder", "environment", "columns")
)


def section(title):
    return PAGE.split(f"\n## {title}")[1].split("\n## ")[0]


def first_cells(title):
    rows = [line.split(" | ")[0] for line in section(title).splitlines() if line.startswith("| `")]
    return [word for cell in rows[1:] for word in cell.removeprefix("| ").split(", ")]


@pytest.mark.parametrize(
    ("title", "names"),
    [
        ("Outcomes", OUTCOMES),
        ("When the policy itself fails", POLICY_FAULTS),
        ("Errors", FAULTS),
    ],
)
def test_every_way_to_end_has_its_line_and_no_other(title, names):
    assert sorted(first_cells(title)) == sorted(f"`{name}`" for name in names)


def test_the_columns_that_are_in_no_digest_are_told():
    measured = MEASURED - {name for name in SCHEMA.names if name.endswith("_s")}
    told = PAGE.split("# Columns of")[1]
    assert set(re.findall(r"`(\w+)`", told)) >= measured | OF_THE_PLAN


def test_its_limits_are_those_of_the_code():
    assert HUGE == 1e6, "the page says a million"


def rows(title):
    """The rows of a section's first table, as cells."""
    text = re.search(r"(?:^\|.*\n)+", f"{section(title)}\n", re.MULTILINE)
    table = [] if text is None else text[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def test_its_exit_codes_are_the_readmes_and_the_gates():
    said: dict[int, str] = {}
    for code, word, _ in rows("Exit codes"):
        said[int(code)] = f"{said.get(int(code), '')} {word}"
    interrupted = 128 + signal.SIGINT  # As shells have it.
    assert list(said) == sorted({*EXIT_CODES.values(), UsageError.exit_code, interrupted})
    table = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split("| code | verdict |")[1]
    assert list(said) == sorted(
        {int(code) for code in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)}
    )
    for word, code in EXIT_CODES.items():
        assert word in said[code]


def test_every_file_of_a_run_has_its_line():
    run = RunFolder(path=Path("run"))
    parts = [
        getattr(run, key) for key, part in vars(RunFolder).items() if isinstance(part, property)
    ]
    files = {run.relative(part) for part in parts if isinstance(part, Path)} - {"mcap"}
    told = {name.strip("`"): words for name, words in rows("Files of a run")}
    assert set(told) == files | {run.relative(run.mcap("<scene>", "<trial>"))}
    keys = set(re.findall(r"`(\w+)`", told["run.json"]))
    assert len(keys) > 8
    assert keys <= set(RunInfo.model_fields)


def test_every_variable_that_the_code_looks_at_or_sets_is_told():
    sources = "\n".join(path.read_text("utf-8") for path in (ROOT / "harness").rglob("*.py"))
    names = set(re.findall(r'environ(?:\.get\(|\[)"(\w+)"', sources))
    assert "NW_EVAL_CACHE" in names
    names |= {*re.findall(r'"(NW_EVAL_\w+)"', sources), *machine._SETTINGS}
    names |= {*family._CHILDREN, *family._FENCED}
    # One word stands for the numbers of threads.
    wanted = {name for name in names if not name.endswith("_THREADS")} | {"OMP_NUM_THREADS"}
    assert wanted <= set(re.findall(r"[`$]([A-Z_]+)[`/]", section("Environment variables")))


def test_every_extra_is_told():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    told = {name.strip("`[]") for name, _ in rows("Extras")}
    assert told == set(project["optional-dependencies"])
