"""Comments of strangers' jobs, as GitHub's own renderer shows what post.py makes of them."""

import re
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from random import Random

import pytest
from cmarkgfm.cmark import Options, github_flavored_markdown_to_html

from nw_eval.reporting.github import comment_page, summary_page
from nw_eval.reporting.markdown import escaped, markdown_table
from nw_eval.reporting.tables.table import Table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import combined, without_baseline
from nw_gate.results.provenance import PolicyInfo

ROOT = Path(__file__).parents[4]
LINK = "https://github.example/o/r/actions/runs/12"
MARK = "<!-- nw-eval: hurdles -->"
FENCE = "```"

_SPEC = spec_from_file_location("post", ROOT / ".github/actions/nw-eval-comment/post.py")
assert _SPEC is not None
assert _SPEC.loader is not None
post = module_from_spec(_SPEC)
_SPEC.loader.exec_module(post)

# HTML of raw texts is shown, as GitHub's sanitizer would meet it; a comment's line ends are breaks.
rendered = partial(
    github_flavored_markdown_to_html,
    options=Options.CMARK_OPT_UNSAFE | Options.CMARK_OPT_FOOTNOTES | Options.CMARK_OPT_HARDBREAKS,
)

ELEMENTS = {"p", "strong", "h1", "h2", "ul", "li", "code", "details", "summary", "a"}
TABLES = {"table", "thead", "tbody", "tr", "th", "td"}
# What GitHub itself makes of the text of a comment, outside of code: mentions, references to
# issues and commits, emoji, formulas, and addresses that its renderer has left.
LIVE = (
    r"@[A-Za-z0-9]",
    r"#[0-9]",
    r"(?i)gh-[0-9]",
    r"(?i)(?<![A-Za-z0-9])[0-9a-f]{7,40}(?![A-Za-z0-9])",
    r":(?:\+1|-1|100|[a-z0-9_+-]*[a-z][a-z0-9_+-]*):",
    r"\$",
    r"(?i)www\.|://|mailto:|xmpp:",
)


class Shown(HTMLParser):
    """A rendered comment: its elements with attributes, and its text outside of code."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.elements = []
        self.comments = []
        self.others = []
        self.text, self.code = "", ""
        self._in_code = 0
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self._in_code += tag == "code"

    def handle_endtag(self, tag):
        self._in_code -= tag == "code"

    def handle_data(self, data):
        if self._in_code:
            self.code += data
        else:
            self.text += data

    def handle_comment(self, data):
        self.comments.append(data)

    def handle_decl(self, decl):
        self.others.append(decl)

    def handle_pi(self, data):
        self.others.append(data)

    def unknown_decl(self, data):
        self.others.append(data)


def faults(body):
    """What a comment shows or does that nw-eval's do not."""
    shown = Shown(rendered(body))
    found = [f"<{tag}>" for tag, _ in shown.elements if tag not in ELEMENTS | TABLES]
    allowed = {"a": [{"href": LINK}]}
    for tag in ("th", "td"):
        allowed[tag] = [{}, {"align": "right"}]
    found += [f"{tag} {has}" for tag, has in shown.elements if has not in allowed.get(tag, [{}])]
    names = [tag for tag, _ in shown.elements]
    found += [f"{names.count(tag)} {tag}" for tag in ("a", "strong") if names.count(tag) != 1]
    found += ["details"] if names.count("details") > 1 else []
    found += shown.others
    found += [] if len(shown.comments) == 1 else [f"comments: {shown.comments}"]
    told = "nw-eval: what this run of the pull request's own code reports."
    found += [] if told in shown.text else ["its first line is not its own"]
    return found + [found[0] for live in LIVE if (found := re.findall(live, shown.text))]


def posted(text):
    """What is posted of a text under the suite's mark."""
    mark, words = post.text_of(f"{MARK}\n{text}".encode(errors="surrogatepass"))
    return post.body_of(mark, words, LINK)


TRICKS = [
    # Code spans that are not where a line says they are.
    "`a\n@maintainer` b",
    "* `a\n* @maintainer` b",
    "`` ` @maintainer ` ``",
    "``` @maintainer",
    "`a``b` @maintainer `c``d`",
    "`a` @maintainer `b`",
    "\\`@maintainer\\`",
    "`\\` @maintainer `\\`",
    "`a``` @maintainer ```b`",
    "`` @maintainer",
    "`code` www.evil.example `code`",
    "`a` `b\n\nc` @maintainer `",
    "x`@maintainer`",
    "`@maintainer`x",
    "``",
    "` `",
    "`a\\\\|b` @maintainer",
    # Fences, and blocks of code.
    f"{FENCE}\n<b>x</b>\n{FENCE}",
    f"{FENCE}html\n@maintainer\n{FENCE}\n@maintainer",
    "~~~\n@maintainer\n~~~\n@maintainer",
    f"{FENCE}mermaid\ngraph TD; A-->B;\n{FENCE}",
    f"{FENCE}math\nx^2\n{FENCE}",
    f'{FENCE}geojson\n{{"type": "Point"}}\n{FENCE}',
    f"{FENCE}suggestion\nrm\n{FENCE}",
    f"* {FENCE}\n@maintainer",
    "    indented `\n@maintainer `",
    "\t@maintainer",
    # Tables.
    "| a | b |\n| - | - |\n| `x | @maintainer` |",
    "| a | b |\n| --- | --- |\n| `x | @maintainer` |",
    "| a | b |\n| --- | --- |\n| `x \\| y` | @maintainer |",
    "| a |\n| --- |\n| `x\\\\| @maintainer` |",
    "| a |\n| --- |\n| <b>x</b> |",
    "| a |\n| --- |\n| [x](http://evil.example) |",
    "| a |\n| --- |\n| ![x](http://evil.example/p.png) |",
    "| a | b |\n| --- |\n| `x | @maintainer` | y |",
    "a | b\n--- | ---\n`x | @maintainer`",
    "a\n:-:\n@maintainer",
    "| a |\n| --- |\n| x |\n@maintainer",
    "| a |\n| --- |\n|     <b> |",
    "| a |\n| --- |\n| &lt;b&gt;&#64;maintainer |",
    # Entities.
    "&#64;maintainer",
    "&#x40;maintainer",
    "&commat;maintainer",
    "&num;1",
    "&lt;b&gt;",
    "\\&#64;maintainer &#64;x",
    "&#0; &#xFFFD; &nbsp;",
    "&colon;tada&colon;",
    # Links that make themselves.
    "https://evil.example",
    "http\\://evil.example",
    "HTTPS://evil.example",
    "ftp://evil.example",
    "www.evil.example",
    "_www.evil.example",
    "\\_www.evil.example",
    "(www.evil.example)",
    "WWW.EVIL.EXAMPLE",
    "someone@evil.example",
    "a.b-c_d@-evil.example",
    "mailto:someone@evil.example",
    "mailto\\:someone@evil.example",
    "xmpp:someone@evil.example/x",
    "someone\\@evil.example",
    "<https://evil.example>",
    "<someone@evil.example>",
    "<mailto\\:x@evil.example>",
    # Links that are made elsewhere, pictures, footnotes.
    "[click](https://evil.example)",
    "[click](javascript:alert(1))",
    "[click](</o/r/settings>)",
    "[click](/o/r/settings 'title')",
    "[click][x]\n\n[x]: https://evil.example",
    "[x]\n\n[x]: /o/r/settings",
    "[x]: /o/r/settings",
    "[this run]: https://evil.example",
    "![](//evil.example/p.png)",
    "![x][y]\n\n[y]: p.png",
    "\\![x](p.png)",
    "\\\\[click](p.png)",
    "\\[click](p.png)",
    "x[^1]\n\n[^1]: @maintainer",
    "[^1]: footnote",
    "* [ ] a task",
    "* [x] a task",
    # HTML: all seven kinds of blocks, and inline.
    "<script>alert(1)</script>",
    "<pre>x</pre>",
    "<style>p{}</style>",
    "<textarea>",
    "<!-- hidden -->",
    "<!-- nw-eval: other -->",
    "--> <b>",
    "<?php x ?>",
    "<!DOCTYPE html>",
    "<![CDATA[x]]>",
    "<div>\n@maintainer\n</div>",
    "<img src=x onerror=alert(1)>",
    "<custom-element>",
    "x <b>y</b>",
    "\\\\<b>",
    "\\<b>",
    "<details><summary>x</summary>",
    "<details open>",
    "<details><summary>The rest of the report</summary>\n<b>\n\n</details>",
    "<details><summary>The rest of the report</summary>",
    "</details>",
    "<details><summary>The rest of the report</summary>\n\nx\n\n</details>\n\nafterwards",
    "</details>\n\nx\n\n<details><summary>The rest of the report</summary>",
    "* <details><summary>The rest of the report</summary>",
    "<picture><source srcset=x></picture>",
    "</p><a href=//evil.example>x</a>",
    # Mentions and references.
    "@maintainer",
    "\\@maintainer",
    "\\\\@maintainer",
    "(@maintainer)",
    "*@maintainer*",
    "@o/team",
    "cc:@maintainer",
    "fixes #1",
    "\\#1",
    "o/r#1",
    "GH-1",
    "_GH-1",
    "0123abcd",
    "o/r@0123abcd",
    "0123abcd...4567abcd",
    "0123456789abcdef0123456789abcdef01234567",
    # Formulas and emoji.
    "$x^2$",
    "$`x^2`$",
    "$$\nx\n$$",
    "\\$x\\$",
    ":tada:",
    ":+1: :octocat:",
    "\\:tada\\:",
    # What cannot be seen, or turns around.
    "@\u200bmaintainer",
    "a\u200db",
    "turned \u202eniatniam@",
    "\u2066x\u2069",
    "\ufeff@maintainer",
    "x\u00ady",
    "a\u00a0b",
    "a\u2028@maintainer",
    "a\u2029b",
    "NUL \0 <b>",
    "a\r@maintainer",
    "`a\r@maintainer` b",
    "a\r\n\r\n<b>",
    "a\x0b@maintainer",
    "a\x0c<b>",
    "a\x85b",
    "\x1b[2J",
    "\ue000",
    "\U000e0041",
    "\ud800",
    # What looks alike.
    "\uff20maintainer \uff1cb\uff1e",
    "\uff03\uff11",
    "\u0430dmin",
    # Structure.
    "# a\n@maintainer",
    "#\t@maintainer",
    "### third level",
    "a\n===",
    "a\n---",
    "* * *",
    "___",
    "> quoted @maintainer",
    "> > * `a\n> @maintainer`",
    "* a\n  * `b\n    @maintainer`",
    "* a\n@maintainer",
    "* 1. nested",
    "* - nested",
    "1. @maintainer",
    "1) <b>",
    "+ <b>",
    "- <b>",
    "* *emphasis*",
    "**nw-eval**: all is well",
    "~~gone~~",
    "*a*_b_",
    "a\\\nb",
    "a  \nb",
    "**nw-eval**: what [this run](https://evil.example) of the pull request's own code reports.",
    "x" * 5000 + " @maintainer",
    "*" * 3000,
    "[" * 3000,
    "`" * 3001,
    "> " * 500 + "x",
    "* " * 200 + "x",
    # Of those who wrote post.py, once all of the above held.
    "`a`\t@maintainer",
    "* `a` `\n* ` @maintainer",
    "| `a |\n| --- |\n| b` @maintainer |",
    "|\n| --- |\n| x |",
    "| |\n| --- |\n| `a\\ | b` |",
    "\\\\`a` @maintainer",
    "`a\\|` `\\|@maintainer`b",
    "# `a\n# @maintainer`",
    "a_www.evil.example",
    "*_www.evil.example_*",
    "a\n\n\n\n    @maintainer",
    "`\u0300` @maintainer",
    "a\\ b",
    "\\a\\@\\b",
    "`!--` <!-- `-->`",
    "| a |\n| --- |\n\n| @b |\n| --- |",
    "a\\\\`b` @maintainer",
    "`a`\u3000@maintainer",
    "| a |\n| --- |\n| `b` | @maintainer |",
    "| a |\n| ---: |\n| \\\\| @maintainer |",
    "# a #1",
    "* a\n\n  @maintainer",
    "`a`_@maintainer_",
    "`<!--`\n\n`-->`<b>",
    "\u202a\u2060@maintainer",
    "a:octocat:b",
    "\uff5c \uff40@maintainer\uff40",
    "x\\\n<b>",
    "`\\`\\|`@x`",
    "1\\. a\n2. <b>",
    "| a\\\\ | b |\n| --- | --- |\n| `x\\\\\\| @m` | y |",
    "ab\u0301@maintainer",
    "gH-12",
    "`0123abcd`0123abcd",
    "user:pass@evil.example",
    "\\\\\\<b>",
]


def test_there_are_tricks_enough():
    assert len(set(TRICKS)) == len(TRICKS) >= 200


WAYS = {
    "a text": "{}",
    "after a headline": "# REGRESSED: hurdles, go1\n\n{}\n",
    "among reasons": "* first\n* {}\n* last\n",
    "in a cell": "| a | b |\n| --- | --- |\n| {} | `c` |\n| `d` | e |\n",
    "in a code cell": "| a | b |\n| --- | --- |\n| `{}` | c |\n",
    "behind the fold": (
        "x\n\n<details><summary>The rest of the report</summary>\n\n{}\n\n</details>\n"
    ),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS.keys())
def test_no_trick_makes_a_comment_do_more_than_nw_evals_own_do(way):
    bad = {text: found for text in TRICKS if (found := faults(posted(way.format(text))))}
    assert bad == {}


def test_the_renderer_shows_what_the_tricks_do_where_nobody_judges_them():
    # Else the test above could not fail.
    texts = [text for text in TRICKS if text != "\ud800"]
    done = [text for text in texts if faults(post.body_of(MARK, text, LINK))]
    assert len(done) > 0.7 * len(TRICKS)


PIECES = [
    *"`\\|@#$*_~<>[]()!&;:-+=.1a\n ",
    *(
        "  ",
        "``",
        "```",
        "\n\n",
        "\n* ",
        "\n# ",
        "\n| ",
        " |\n| --- |\n",
        " | ",
        "\\|",
        "www.",
        "b",
    ),
    *(
        "www.",
        "http://",
        "@x",
        "#1",
        "<b>",
        "&#64;",
        "0123abc",
        ":a:",
        "mailto:",
        "\u0300",
        "]: ",
        "\\`",
    ),
]


def test_nothing_put_together_by_chance_is_posted_and_does_more():
    random = Random(35)
    shown = 0
    for _ in range(6000):
        text = "".join(random.choices(PIECES, k=random.randint(1, 12)))
        body = posted(text)
        shown += post.TELLING not in body
        assert faults(body) == [], text
    assert shown > 300


def test_words_of_strangers_are_escaped_so_that_they_are_posted_and_do_nothing():
    random = Random(36)
    for number in range(3000):
        words = "".join(random.choices(PIECES, k=random.randint(1, 12)))
        words = TRICKS[number] if number < len(TRICKS) else words
        table = Table(title="x", columns=("a", "b"), rows=((words, words),), code=frozenset({"b"}))
        page = f"# {escaped('x ' + words)}\n\n* {escaped(words)}\n\n{markdown_table(table)}"
        body = posted(page)
        assert page in body, words
        assert faults(body) == [], words


# Comments as nw-eval writes them.


@pytest.fixture
def comments(make_row, make_run, evil, regressed):
    """Comments on runs of every verdict, some with words of strangers in every place."""
    scenes = ("hurdles/one", "gaps/a_b", "places/kitchen")
    planned = dict.fromkeys(scenes, 20)
    bar = Gate(success_rate=0.75, tiers={"gaps/*": "critical"})
    run = make_run(planned, suite={"name": "hurdles", "seed": 7})
    trials = {
        "PASS": [make_row(scene, k, 4) for scene in scenes for k in range(20)],
        "REGRESSED": [make_row(scene, k, k % 2) for scene in scenes for k in range(20)],
        "INCONCLUSIVE": [make_row(s, k, 4 - 2 * (k % 2)) for s in scenes for k in range(20)],
        "INFRASTRUCTURE": [make_row(scene, k, None) for scene in scenes for k in range(20)],
    }
    judged = {word: (run, rows, judge(rows, bar, planned)) for word, rows in trials.items()}
    rows = trials["REGRESSED"]
    judged["RAN"] = (run, rows, judge(rows, Gate(), planned))
    against = combined(judge(rows, Gate(), planned, against=regressed), regressed)
    judged["baseline"] = (run, rows, against)
    invalid = without_baseline(
        judged["PASS"][2], "baseline 0123456789ab is gone: https://x.example @x"
    )
    judged["INVALID"] = (run, trials["PASS"], invalid)
    many = {f"places/{k:05d}": 1 for k in range(300)}
    some = [make_row(scene, 0, k % 5) for k, scene in enumerate(many)]
    judged["many"] = (make_run(many), some, judge(some, bar, many))
    hostile = make_run(
        planned,
        policy=PolicyInfo(name=evil, checkpoint_digest="cc" * 32, card=evil),
        suite_file=evil,
        renderer=evil,
        versions={evil: evil},
        engine={evil: evil},
        interrupted=True,
    )
    words = {"policy": evil, "error_text": evil, "end_reason": evil, "error_type": evil}
    own = [make_row(scene, k, (None, 0, 4)[k % 3], **words) for scene in scenes for k in range(20)]
    verdict = judge(own, bar, planned)
    judged["hostile"] = (hostile, own, replace(verdict, reasons=(*verdict.reasons, evil)))
    for number, trick in enumerate(TRICKS):
        said = replace(judged["PASS"][2], reasons=(trick,))
        judged[f"reason {number}"] = (run, trials["PASS"][:4], said)
    return {name: comment_page(*facts, Path("reports/r|x @y")) for name, facts in judged.items()}


def test_what_nw_eval_writes_is_posted_as_it_is_and_renders_to_nothing_else(comments):
    for verdict in ("PASS", "REGRESSED", "INCONCLUSIVE", "INFRASTRUCTURE", "RAN", "INVALID"):
        assert comments[verdict].startswith(f"{MARK}\n# {verdict}: ")
    for name, comment in comments.items():
        mark, text = post.text_of(comment.encode())
        assert f"{mark}\n{text}" == comment.strip("\n"), name
        assert faults(post.body_of(mark, text, LINK)) == [], name


def test_the_step_summary_renders_to_nothing_else_either(make_row, make_run, evil):
    rows = [make_row("a", k, None, error_text=evil, error_type=evil) for k in range(3)]
    run = make_run({"a": 3}, policy=PolicyInfo(name=evil, checkpoint_digest="cc" * 32))
    verdict = judge(rows, Gate(success_rate=0.75), {"a": 3})
    verdict = replace(verdict, reasons=(*verdict.reasons, *TRICKS))
    page = summary_page(run, rows, verdict, Path("reports/r"))
    assert faults(post.body_of(MARK, page, LINK)) == []
