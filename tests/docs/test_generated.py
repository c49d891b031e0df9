"""The generated parts of the site have every verb, key, column, topic, score and public name."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
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
from nw_scenes.robots.folder import RobotFile
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
    assert sorted(named) == sorted(generate.parts())


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
    **{kind: api.schema(kind) for kind in ("suite", "policy", "scene", "collision")},
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


def test_every_public_name_is_shown() -> None:
    text = f"{generate.api_of(functions=True)}\n{generate.api_of(functions=False)}"
    told = re.findall(r"^::: nw_[\w.]+\.(\w+)$", text, re.MULTILINE)
    assert sorted(told) == sorted(name for name in nw_eval.__all__ if not name.startswith("_"))


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


@pytest.mark.nightly
def test_the_site_builds_without_a_warning_and_fetches_nothing(tmp_path: Path) -> None:
    pytest.importorskip("material")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
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
