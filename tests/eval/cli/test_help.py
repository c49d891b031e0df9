"""What `--help` says, what wrong arguments are answered, and names that verbs had before."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from email.message import Message
from importlib import metadata
from pathlib import Path

import pytest
from command_line import ends
from tyro.extras import get_parser

from nw_eval.cli.verbs import _config, forms, parse, program_page, table
from nw_eval.cli.verbs.help import options_of
from nw_eval.cli.verbs.table import (
    GROUPS,
    OPTION_GROUPS,
    OUT_WAS_POSITIONAL,
    RENAMED,
    RENAMED_FLAGS,
    VERBS,
    docs_line,
)

DOCS = Path(__file__).parents[3] / "docs"
LEAVES = dict(forms())
EXAMPLES = [
    f"{verb} {words}".strip()
    for verb, known in VERBS.items()
    for words in [*known.examples, *(f"{part} {e}" for part, (_, e, _) in known.parts.items())]
]


def test_the_program_page_has_each_verb_once_under_a_title_within_80_columns():
    lines = program_page("").splitlines()
    assert max(map(len, lines)) <= 80
    for title, verbs in GROUPS.items():
        place = lines.index(f"{title}:")
        listed = [line.split(maxsplit=1) for line in lines[place + 1 : place + 1 + len(verbs)]]
        assert listed == [[name, verb.line] for name, verb in verbs.items()]
        assert all(line for _, line in listed)


def test_the_program_page_loads_neither_tyro_nor_anything_heavy():
    code = (
        "import sys; from nw_eval.cli.verbs import program_page; program_page('');"
        "print([m for m in ('tyro', 'numpy', 'pydantic', 'rich') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert shown.stdout == b"[]\n"


def test_every_verb_has_a_page_of_the_docs_and_an_example():
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    for name, verb in VERBS.items():
        assert verb.page in pages, name
        assert verb.examples or len(verb.parts) > 1, name


def test_every_example_is_taken():
    for example in EXAMPLES:
        assert callable(parse(shlex.split(example), description="")), example


@pytest.mark.parametrize("name", LEAVES)
def test_the_page_of_a_verb_says_each_thing_once_and_fits_the_terminal(name, capsys, monkeypatch):
    columns = 70
    monkeypatch.setenv("COLUMNS", str(columns))
    assert ends(*f"{name} --help".split()) == 0
    page = capsys.readouterr().out
    assert "(default: None)" not in page
    assert "docs/" in page.splitlines()[-1]
    head = " ".join(LEAVES[name].__doc__.split("\n\n")[0].split())
    assert " ".join(page.split()).count(head) == 1
    for option in options_of(LEAVES[name]):
        assert option.help, option
        assert option.shown in page
    for line in page.split("\nExamples:")[0].splitlines():
        assert len(line) <= columns or " " not in line.strip() or line.strip().startswith("-"), line


def test_options_of_a_verb_that_has_many_are_listed_under_titles(capsys):
    assert ends(*["run", "--help"]) == 0
    titles = re.findall(r"^(\w[\w ]*):$", capsys.readouterr().out, re.MULTILINE)
    assert titles == [
        *("Arguments", "Policy and robot", "Trials", "Comparison", "Machine", "Output"),
        "Examples",
    ]
    names = [name for listed in OPTION_GROUPS.values() for name in listed]
    assert len(names) == len(set(names))


def test_a_title_of_a_package_stands_over_options_of_its_own_verbs_only(capsys):
    assert ends("baseline", "save", "--help") == 0
    assert "Gaussians:" not in capsys.readouterr().out
    assert ends("twin", "build", "--help") == 0
    assert "\nGaussians:\n" in capsys.readouterr().out


def test_the_same_letter_and_the_same_word_stand_for_one_option_in_all_verbs():
    letters = {}
    for form in LEAVES.values():
        for option in options_of(form):
            for letter in option.flags[:-1]:
                assert letters.setdefault(letter, option.flags[-1]) == option.flags[-1]
    assert letters == {"-p": "--policy", "-n": "--trials", "-j": "--workers"}


def test_every_option_that_names_a_policy_has_its_letter():
    options = [(name, option) for name, form in forms() for option in options_of(form)]
    named = [(name, option) for name, option in options if "--policy" in option.flags]
    assert len(named) > 10
    assert [name for name, option in named if "-p" not in option.flags] == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("rnu", "no command 'rnu'; did you mean run?"),
        ("baseline sav", "no command 'sav'; did you mean save?"),
        ("baseline", "no command; give one of save, list, show"),
        ("run --baselin x", "nw-eval run has no option --baselin; did you mean --baseline?"),
        ("run smoke --against X", "has no option --against; did you mean --baseline? (`nw-eval"),
        ("run smoke --card X", "nw-eval run has no option --card; did you mean --policy?"),
        ("run smoke --zzzz", "has no option --zzzz; `nw-eval run --help` lists them"),
        ("check --trails 3", "nw-eval check has no option --trails; did you mean --trials?"),
        ("run smoke hurdles", "nw-eval run takes no argument 'hurdles'"),
        ("run smoke --trials many", "--trials many; give a whole number"),
        ("run smoke --trials=1.5", "--trials 1.5; give a whole number"),
        ("run smoke --time-limit soon", "--time-limit soon; give a number"),
        ("run smoke --trials", "--trials has no value; give --trials N"),
        ("run smoke --record some", "--record some; give one of all, failures, none, summary"),
        ("schema suit", "KIND suit; give one of suite, policy, scene, collision"),
        ("splat render a --eye 1 2", "--eye 1 2; give X Y Z"),
        ("merge part", "nw-eval merge: --out PATH is missing; the folder of the merged run"),
        ("report --junit", "--junit has no value"),
        ("check", "nw-eval check: SUITE is missing; a suite file or"),
        ("splat render a --eye 1 y 2", "--eye 1 y 2; give X Y Z"),
        ("completion", "SHELL is missing; give one of bash, zsh, fish"),
    ],
)
def test_wrong_arguments_are_answered_in_a_line_that_names_them(words, said, capsys):
    assert ends(*words.split()) == 2
    shown = capsys.readouterr()
    [line] = shown.err.splitlines()
    assert line.startswith("error: ")
    assert said in line
    assert shown.out == ""


@pytest.mark.filterwarnings("ignore:get_parser:DeprecationWarning")
def test_the_pages_of_the_docs_can_read_the_options_of_each_verb():
    found = {
        name: {flag for action in parser._actions for flag in action.option_strings}
        for name, parser in (
            (name, get_parser(form, prog=name, config=_config())) for name, form in LEAVES.items()
        )
    }
    for name, form in LEAVES.items():
        own = {flag for option in options_of(form) for flag in option.flags}
        assert found[name] == {*own, "-h", "--help"}


def test_the_docs_are_a_file_that_is_there_or_the_address_of_the_package_or_not_named(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(metadata, "metadata", lambda _: Message())
    monkeypatch.chdir(DOCS.parent)
    assert docs_line("how-to/view.md") == []
    assert docs_line("how-to/viewing.md") == ["Docs: docs/how-to/viewing.md"]
    monkeypatch.chdir(tmp_path)
    [line] = docs_line("how-to/viewing.md")
    assert Path(line.removeprefix("Docs: ")).is_file()
    monkeypatch.setattr(table, "_CHECKOUT", tmp_path)  # As of a wheel.
    assert docs_line("how-to/viewing.md") == []
    assert "Docs:" not in program_page("")
    package = Message()
    package["Project-URL"] = "Paper, https://example.org/paper"
    package["Project-URL"] = "Documentation, https://example.org/docs/"
    monkeypatch.setattr(metadata, "metadata", lambda _: package)
    assert docs_line("how-to/viewing.md") == ["Docs: https://example.org/docs/how-to/viewing"]
    assert docs_line() == ["Docs: https://example.org/docs/"]


def test_a_switch_that_is_on_is_told_by_what_turns_it_off():
    @dataclass
    class Form:
        pictures: bool = True
        """Draw."""

    assert [option.flags for option in options_of(Form)] == [("--no-pictures",)]


def test_without_a_command_the_page_is_printed_and_the_exit_code_is_2(capsys):
    assert ends() == 2
    assert capsys.readouterr().out.startswith("usage: nw-eval COMMAND")
    assert ends(*["help", "run"]) == 0
    assert capsys.readouterr().out.startswith("usage: nw-eval run")


@pytest.mark.parametrize(("then", "now"), RENAMED.items())
def test_a_verb_is_understood_by_its_name_before_with_a_notice(then, now, capsys):
    parse([then, *shlex.split(VERBS[now].examples[0])], description="")
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"notice: nw-eval {then} is nw-eval {now} now")
    assert then not in VERBS
    assert f"  {then} " not in program_page("")


@pytest.mark.parametrize(
    ("name", "then", "now"),
    [(name, *pair) for name, flags in RENAMED_FLAGS.items() for pair in flags.items()],
)
def test_an_option_is_understood_by_its_name_before_with_a_notice(name, then, now, capsys):
    flags = {flag: option for option in options_of(LEAVES[name]) for flag in option.flags}
    assert then not in flags
    if now not in flags:
        assert name.startswith("twin ")  # Not all of them take workers.
        return
    value = (flags[now].choices or ("3",))[-1]
    needed = [
        word
        for option in options_of(LEAVES[name])
        if option.is_required and now not in option.flags
        for word in (*option.flags[-1:], "x")
    ]
    parsed = parse([*name.split(), *needed, f"{then}={value}"], description="")
    assert str(getattr(parsed, flags[now].name)) == value
    assert capsys.readouterr().err.startswith(f"notice: {then} is {now} now")


@pytest.mark.parametrize("name", sorted(OUT_WAS_POSITIONAL))
def test_what_is_written_was_the_last_argument_before(name, capsys):
    assert parse([*name.split(), "in.ply", "out.ply"], description="").out == Path("out.ply")
    assert "is --out OUT now" in capsys.readouterr().err
    assert (
        parse([*name.split(), "--out", "out.ply", "in.ply"], description="").out.name == "out.ply"
    )
    assert capsys.readouterr().err == ""


BASH = """
source "$1"
shift
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
_nw_eval
echo "${COMPREPLY[@]}"
"""


def test_bash_completes_verbs_options_and_their_words(tmp_path, capsys):
    assert ends(*["completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)

    def completed(*words):
        line = ["bash", "-c", BASH, "bash", str(script), "nw-eval", *words]
        done = subprocess.run(line, capture_output=True, text=True, check=True)
        assert done.stderr == ""
        return done.stdout.split()

    assert completed("swe") == ["sweep"]
    assert completed("baseline", "s") == ["save", "show"]
    assert completed("run", "x", "--rec") == ["--recheck", "--record"]
    assert completed("run", "--record", "") == ["all", "failures", "none", "summary"]
    assert completed("twin", "build", "--mesher", "o") == ["openmvs"]
    assert completed("run", "") == [], "bash itself completes files"


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish here")
def test_fish_completes_verbs_options_and_their_words(tmp_path, capsys):
    assert ends(*["completion", "fish"]) == 0
    script = tmp_path / "completion.fish"
    script.write_text(capsys.readouterr().out)

    def completed(line):
        ask = ["fish", "--no-config", "-c", f"source {script}; complete -C '{line}'"]
        done = subprocess.run(ask, capture_output=True, text=True, check=True)
        return [each.split("\t")[0] for each in done.stdout.splitlines()]

    assert completed("nw-eval swe") == ["sweep"]
    assert completed("nw-eval baseline s") == ["save", "show"]
    assert completed("nw-eval baseline check --tr") == []
    assert completed("nw-eval check --tr") == ["--trials"]
    assert completed("nw-eval run --record ") == ["all", "failures", "none", "summary"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_reads_its_script(shell, tmp_path, capsys):
    assert ends(*f"completion {shell}".split()) == 0
    script = tmp_path / shell
    script.write_text(shown := capsys.readouterr().out)
    assert all(verb in shown for verb in VERBS)
    assert "blame" not in shown
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    subprocess.run([shell, "-n", str(script)], check=True)


def test_doctor_says_what_there_is_as_text_and_as_json(capsys):
    from nw_sim.warmup import warm_kernels

    assert ends(*["doctor"]) == 0
    text = capsys.readouterr().out
    for word in ("nw-eval", "Python", "mujoco", "fence", "usable", "memory", "cache", "extras"):
        assert word in text
    assert ends(*["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["problems"] == []
    assert found["kernels"] == list(warm_kernels())
    assert found["processor"]["usable"] <= found["processor"]["affinity"]
    assert {"numpy", "torch", "openblas"} <= set(found["versions"])


def test_doctor_runs_from_a_folder_that_is_not_installed(capsys, monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", absent)
    monkeypatch.setattr(metadata, "version", absent)
    assert ends(*["doctor"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^extras +unknown$", text, re.MULTILINE)
    warned = re.findall(r"^warning +(.+)$", text, re.MULTILINE)
    assert any(each.startswith("nw-eval runs from a folder") for each in warned)
    assert ends(*["doctor", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["extras"] == {}


def test_doctor_names_what_is_broken_and_ends_with_4(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "file" / "cache"))
    assert ends(*["doctor"]) == 4
    assert re.search(r"PROBLEM +cannot write .*set NW_EVAL_CACHE", capsys.readouterr().out)
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path))
    monkeypatch.setattr("nw_eval.api.doctor._is_met", lambda need: need.name != "mujoco")
    assert ends(*["doctor", "--json"]) == 4
    assert "mujoco" in json.loads(capsys.readouterr().out)["problems"][0]
