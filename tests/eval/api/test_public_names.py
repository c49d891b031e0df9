"""What `import nw_eval` gives: every public name, at once in an editor, and late in a process."""

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

import nw_eval
import nw_gate
from nw_eval import api
from nw_eval.api.renamed import keywords_were
from nw_eval.cli.verbs.table import RENAMED

STUB = Path(nw_eval.__file__).with_suffix(".pyi")
VERBS = {name: each for name in api.__all__ if inspect.isfunction(each := getattr(api, name))}
PLAIN = {"Any", "DataFrame", "Generator", "Path", "dict", "pd", "str", "tuple"}


def test_importing_it_loads_nothing_but_itself():
    code = "import sys; before = {*sys.modules}; import nw_eval; print(*({*sys.modules} - before))"
    bare = [sys.executable, "-c", code]
    loaded = subprocess.run(bare, capture_output=True, text=True, check=True).stdout.split()
    assert {name.partition(".")[0] for name in loaded} <= {
        "__future__",
        "importlib",
        "nw_base",
        "nw_eval",
        "types",
        "warnings",
    }
    assert "nw_eval.api" not in loaded


def test_a_name_is_imported_when_it_is_first_used_and_its_room_costs_no_more_than_it_must():
    code = "import sys, nw_eval; nw_eval.run, nw_eval.evaluate, nw_eval.PolicyError; "
    heavy = "print({'numpy', 'torch', 'mujoco', 'pandas', 'pydantic'} & {*sys.modules})"
    bare = [sys.executable, "-c", code + heavy]
    assert subprocess.run(bare, capture_output=True, text=True, check=True).stdout == "set()\n"


def test_the_stub_says_the_old_names_too():
    tree = ast.parse(STUB.read_text(encoding="utf-8"))
    old = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    marked = [node for node in tree.body if isinstance(node, ast.AnnAssign) and node.value]
    assert old | {ast.unparse(node.target) for node in marked} == {*nw_eval._RENAMED}


@pytest.mark.parametrize("name", nw_eval.__all__)
def test_each_name_is_there_and_is_no_module_with_a_docstring(name):
    value = getattr(nw_eval, name)
    # A room of the same name would take its place as soon as it was imported.
    assert not isinstance(value, types.ModuleType)
    assert not (STUB.parent / name).exists()
    assert not (STUB.parent / f"{name}.py").exists()
    assert name == "__version__" or value.__doc__
    assert name in dir(nw_eval)


def test_every_verb_is_public_and_a_name_that_is_not_is_an_attribute_error():
    assert set(api.__all__) - {"Message"} <= set(nw_eval.__all__)
    with pytest.raises(AttributeError, match="'nw_eval' has no attribute 'rnu'"):
        nw_eval.rnu  # noqa: B018


@pytest.mark.parametrize(
    ("package", "old"), [(each, old) for each in (nw_eval, nw_gate) for old in each._RENAMED]
)
def test_an_old_name_is_the_new_one_with_a_warning_that_says_it(package, old):
    now, name = package._RENAMED[old], package.__name__
    with pytest.warns(DeprecationWarning, match=f"{name}.{old} is now {name}.{now}$") as told:
        assert getattr(package, old) is getattr(package, now)
    assert told[0].filename == __file__
    assert old not in dir(package)


def test_verbs_that_were_renamed_on_the_command_line_are_renamed_in_python():
    assert {was: nw_eval._RENAMED[was] for was in RENAMED} == RENAMED
    assert {*RENAMED.values()} <= {*api.__all__}


@pytest.mark.parametrize(
    ("verb", "positional", "old", "now"),
    [
        ("attribute", ("run",), "at_most", "trials"),
        ("bisect", ("suite", ()), "starts", "baseline_trials"),
        ("check_scenes", ((),), "suite", "out"),
        ("plan_trials", ("suite",), "png", "out"),
        ("save_baseline", ("suite",), "starts", "trials"),
        ("save_baseline", ("suite",), "from_run", "run"),
        ("sweep", (None, ()), "against", "baseline"),
        ("verify", ("run",), "sample", "trials"),
        ("verify_baseline", ("baseline",), "share", "trials"),
        ("watch", ("folder",), "card", "policy"),
    ],
)
def test_an_old_keyword_is_the_new_one_with_a_warning_that_says_it(verb, positional, old, now):
    assert now in inspect.signature(VERBS[verb]).parameters
    both = {old: None, now: None}
    with pytest.raises(TypeError, match=f"got both '{old}' and '{now}', its name now"):
        VERBS[verb](*positional, **both)


def test_a_call_with_an_old_keyword_goes_to_the_new_one():
    @keywords_were(against="baseline")
    def sweep(request, *, baseline=None):
        return request, baseline

    with pytest.warns(
        DeprecationWarning, match=r"sweep\(against=\) is now sweep\(baseline=\)"
    ) as told:
        assert sweep("r", against="stand") == ("r", "stand")
    assert told[0].filename == __file__
    assert sweep("r", baseline="stand") == ("r", "stand")


@pytest.mark.parametrize("verb", VERBS)
def test_no_verb_returns_words(verb):
    """A value has numbers, paths, findings. What is a document stands in a field of its own.

    `schema` gives a JSON Schema as a dict; `CardDraft.text` is the card that was written.
    """
    returned = str(inspect.signature(VERBS[verb]).return_annotation)
    assert not re.match(r"(str|int|bool|None|list)\b|(tuple|Generator)\[str", returned), returned
    for name in set(re.findall(r"\w+", returned)) - PLAIN:
        assert name in nw_eval.__all__, f"{verb} returns a {name}, which is not public"
        value = getattr(nw_eval, name)
        assert dataclasses.is_dataclass(value)
        assert value.__dataclass_params__.frozen
        fields = inspect.signature(value).parameters.values()
        assert {field.kind for field in fields} == {inspect.Parameter.KEYWORD_ONLY}
