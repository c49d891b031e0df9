"""The generated parts of the site have every verb, key, column, topic, score and public name."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tyro.extras import get_parser

import nw_eval
from nw_base.confinement import seccomp
from nw_base.files.yaml_file import json_schema_of
from nw_eval import api
from nw_eval.cli.verbs import _config, forms
from nw_gate.results.parquet import SCHEMA
from nw_gate.scores import BUILT_IN
from nw_scenes.robots.robot_file import RobotFile
from nw_sim.rollout.mcap.topics import TOPICS

if TYPE_CHECKING:
    from argparse import ArgumentParser
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def _generator() -> Any:
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = _generator()


def first_cells(text: str) -> list[str]:
    """The code in the first cells of all tables."""
    rows = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    return [code for row in rows for code in re.findall(r"`([^`]+)`", row)]


def test_a_page_shows_every_part_and_no_part_is_unknown() -> None:
    named = [
        part
        for page in sorted(DOCS.rglob("*.md"))
        for part in re.findall(r"<!-- generated: ([\w -]+) -->", page.read_text("utf-8"))
    ]
    assert set(named) == set(generate.parts())
    several = {part for part in named if named.count(part) > 1}
    assert several == {"example report"}, "two pages say the same"


@pytest.fixture(scope="module")
def verbs() -> str:
    return generate.verbs()


@pytest.fixture(scope="module")
def sections(verbs: str) -> dict[str, str]:
    """The text below each heading."""
    _, *pieces = re.split(r"^#{2,3} (.+)$", verbs, flags=re.MULTILINE)
    return dict(zip(pieces[::2], pieces[1::2], strict=True))


def every_parser() -> Iterator[tuple[str, ArgumentParser]]:
    """Every verb, those of families by two words, with its parser."""
    for name, form in forms():
        parser = get_parser(form, prog=name, config=_config())
        inner = [action.choices for action in parser._actions if isinstance(action.choices, dict)]
        yield name, parser
        for part, each in (found for choices in inner for found in choices.items()):
            yield f"{name} {part}", each


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Of the parser, which is only read.
def test_every_verb_has_its_section_with_all_of_its_options(sections: dict[str, str]) -> None:
    named = dict(every_parser())
    assert len(named) > 50
    assert named.keys() <= sections.keys()
    for name, parser in named.items():
        told = first_cells(sections[name])
        flags = {flag for action in parser._actions for flag in action.option_strings}
        assert flags - {"-h", "--help"} <= set(told), name


def test_options_have_their_defaults_and_words(verbs: str, sections: dict[str, str]) -> None:
    for verb in ("run", "policies check", "scenes import", "baseline save", "train student"):
        assert len(sections[verb].strip().splitlines()[0]) > 10, "a sentence"
    told = [line for line in verbs.splitlines() if "(default" in line]
    assert all(line.count("(default") > 1 for line in told), "one default has a column"
    (port,) = re.findall(r"^\| `--port`.*$", sections["policies serve"], re.MULTILINE)
    assert re.search(r"\| `8765` \| Port to listen on", port)
    assert "| `SUITE` |" in sections["run"]
    assert re.search(r"^\| `CHECKPOINT` \| required \|", sections["policies init"], re.MULTILINE)


SCHEMAS = {
    **{kind: api.schema(kind) for kind in ("suite", "policy", "scene", "collision", "ladder")},
    "robot": json_schema_of(RobotFile),
}


@pytest.mark.parametrize("kind", SCHEMAS)
def test_every_key_of_every_part_stands_in_a_table(kind: str) -> None:
    schema, text = SCHEMAS[kind], generate.keys(kind)
    parts = [schema, *(part for part in schema.get("$defs", {}).values() if "properties" in part)]
    assert first_cells(text) == [
        *schema["properties"],
        *(key for part in _in_order(text, schema) for key in part["properties"]),
    ]
    assert text.count("| key | type | default | meaning |") == len(parts)
    anchors = {generate.anchor(head) for head in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}
    assert len(anchors) == len(parts) - 1, "no two parts have one heading"
    assert set(re.findall(r"\]\(#(.*?)\)", text)) <= anchors


def _in_order(text: str, schema: dict[str, Any]) -> list[dict[str, Any]]:
    """The parts of a schema in the order of their tables, known by their keys and words."""
    sections = re.split(r"^#+ .+$", text, flags=re.MULTILINE)[1:]
    left = [part for part in schema.get("$defs", {}).values() if "properties" in part]
    found = []
    for section in sections:
        keys = first_cells(section)
        (part,) = (
            each
            for each in left
            if list(each["properties"]) == keys
            and generate._prose(each.get("description", "")) in section
        )
        found.append(part)
    assert len(found) == len(left)
    return found


def test_keys_have_type_default_and_meaning() -> None:
    suite = generate.keys("suite")
    assert (
        "| `trials` | integer, at least 1, at most 100000 | required | Trials per scene and"
        in suite
    )
    assert re.search(
        r"^\| `protocol` \| `strict`, `neverwhere-2026` \| `\"strict\"` \|", suite, re.MULTILINE
    )
    assert "| `gate` | [`gate`](#gate) | as below |" in suite
    assert "## `sensor: depth`" in generate.keys("policy")


def test_every_column_topic_and_score_is_there() -> None:
    assert first_cells(generate.columns()) == SCHEMA.names
    assert {topic.name for topic in TOPICS} <= set(first_cells(generate.topics()))
    assert first_cells(generate.scores()) == list(BUILT_IN)


def test_every_public_name_is_shown_on_one_page() -> None:
    pages = {topic: generate.api_of(topic) for topic in generate.TOPICS}
    told = re.findall(r"^::: nw_[\w.]+\.(\w+)$", "\n".join(pages.values()), re.MULTILINE)
    assert sorted(told) == sorted(name for name in nw_eval.__all__ if not name.startswith("_"))
    assert "::: nw_eval.api.runs.run" in pages["runs"]
    assert "::: nw_base.errors.SuiteError" in pages["extending"]
    assert all(pages.values())


def test_a_name_of_a_new_package_has_no_page_until_one_is_named() -> None:
    assert generate.topic_of("nw_eval.api.runs.run") == "runs"
    assert generate.topic_of("nw_sim.rollout.replaying.reports.ReplayReport") == "logs"
    with pytest.raises(LookupError, match="name its place in TOPICS"):
        generate.topic_of("nw_new.thing.Thing")


def test_a_page_of_a_real_run_is_shown_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generate, "EXAMPLE", tmp_path / "example")
    told = generate.example("report")
    assert "<iframe" not in told
    assert "href" not in told
    assert "make docs" in told
    (tmp_path / "example").mkdir()
    (tmp_path / "example" / "report.html").write_text("<p>REGRESSED</p>")
    shown = generate.example("report")
    assert '<iframe src="{up}example/report.html" title="' in shown
    assert '<a href="{up}example/report.html">Open it in full</a>' in shown
    site = SimpleNamespace(site_dir=str(tmp_path / "site"))
    generate.on_post_build(config=site)
    assert (tmp_path / "site" / "example" / "report.html").read_text() == "<p>REGRESSED</p>"


def test_the_commands_of_the_example_pages_are_those_that_make_them() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for file, _, command in generate.EXAMPLES.values():
        verb = " ".join(command.split()[1:3])
        assert f"$(BIN)/nw-eval {verb}" in makefile
        assert file.split("/")[0] in makefile
    assert " ".join(generate.EXAMPLES["report"][2].split()[1:]) in makefile


def test_the_changelog_links_from_the_pages_folder() -> None:
    text = generate.changelog()
    assert "\n## " in text
    assert "](docs/" not in text
    for target in re.findall(r"\]\(([\w/-]+\.md)", text):
        assert (DOCS / target).is_file()


def test_what_only_github_reads_is_put_as_both_read_it() -> None:
    lines = [
        "```yaml my-suite.yaml",
        "a: [b](../c.md)",
        "```",
        "| `a \\| b` | c \\| d |",
        "[pins](../../constraints.txt), [news](../../CHANGELOG.md#unreleased), [x](ci.md)",
    ]
    page = "\n".join(lines)
    assert generate.adapted(page, "how-to/page.md").splitlines() == [
        '```yaml title="my-suite.yaml"',
        "a: [b](../c.md)",
        "```",
        "| `a | b` | c \\| d |",
        "pins (`constraints.txt` of the sources), [news](../changelog.md#unreleased), [x](ci.md)",
    ]


REPOSITORY = "https://code.example/dogs/nw-eval"
LARGEST = 150_000
"""Bytes of a page of the reference, as a browser gets it."""


def built(folder: Path, repository: str = "") -> dict[str, str]:
    """The pages of the site by their paths, without those of runs."""
    pytest.importorskip("material")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    settings = {"NO_MKDOCS_2_WARNING": "1", "NW_EVAL_REPOSITORY": repository}
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    pages = (page for page in folder.rglob("*.html") if folder / "example" not in page.parents)
    return {page.relative_to(folder).as_posix(): page.read_text("utf-8") for page in pages}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return built(tmp_path_factory.mktemp("site"))


@pytest.mark.nightly
def test_a_page_of_the_reference_is_small(site: dict[str, str]) -> None:
    sizes = {name: len(text.encode()) for name, text in site.items() if "reference/" in name}
    assert len(sizes) > 25
    assert {name: size for name, size in sizes.items() if size > LARGEST} == {}
    assert sum("reference/python/" in name for name in sizes) == len(generate.TOPICS)


@pytest.mark.nightly
def test_a_page_leads_to_the_repository_only_where_its_address_is_known(
    site: dict[str, str], tmp_path: Path
) -> None:
    assert not [name for name, text in site.items() if 'title="Edit this page"' in text]
    assert not [name for name, text in site.items() if 'class="md-source"' in text]
    assert 'changelog.html">0.2.0</a>'.replace("0.2.0", nw_eval.__version__) in site["index.html"]
    known = built(tmp_path, REPOSITORY)
    edit = f'<a href="{REPOSITORY}/edit/main/docs/index.md" title="Edit this page"'
    assert edit in known["index.html"]
    assert f'href="{REPOSITORY}/edit/main/CHANGELOG.md"' in known["changelog.html"]
    assert f'href="{REPOSITORY}"' in known["how-to/ci.html"]
    assert 'title="Edit this page"' not in known["reference/python/runs.html"]
    assert f"{REPOSITORY}/releases/expanded_assets" in known["index.html"]
    assert not [name for name, text in known.items() if "OWNER/nw-eval" in text]
    # The theme asks GitHub for stars where it finds this.
    assert not [name for name, text in known.items() if 'data-md-component="source"' in text]


@pytest.mark.nightly
def test_the_site_fetches_nothing(site: dict[str, str]) -> None:
    for page, text in site.items():
        loaded = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"(.*?)\"", text)
        loaded += re.findall(r"<link\b[^>]*rel=\"(?:stylesheet|icon|preconnect)\"[^>]*>", text)
        assert not [each for each in loaded if re.search(r"(?:https?:)?//", each)], page


def test_every_system_call_that_the_fence_allows_stands_in_the_table() -> None:
    told = generate.system_calls()
    texts = (*seccomp.ALLOWED.values(), seccomp.WRITING, seccomp.SERVING, seccomp.CONNECTING)
    names = [name for text in texts for name, _ in seccomp.named(text)]
    assert len(names) > 100
    assert all(f"`{name}`" in told for name in (*names, "FIONBIO", "F_GETFL", "AF_INET6"))


def test_every_operator_that_networks_have_is_listed() -> None:
    from nw_policies.executor.planning import operators
    from nw_policies.networks.recording import RULES

    told = generate.network_operators()
    known = [name for names in operators().values() for name in names]
    assert len(known) > 90
    assert {"Gemm", "LSTM", "com.microsoft::RotaryEmbedding"} <= set(known)
    for name in (*known, *RULES):
        assert f"`{name}`" in told, name
