"""What README and Get started tell a newcomer to type and to write is what the program takes."""

import re
import subprocess
import tomllib
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper
from PIL import Image

from nw_base.errors import PolicyError
from nw_eval import api, cli
from nw_policies import load_bundle
from nw_policies.cards import load_card
from nw_sim.catalogue import names
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.sensors import check_card

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
START = ROOT / "docs" / "index.md"
FILM = ROOT / "docs" / "images" / "film.webp"


def text():
    return README.read_text(encoding="utf-8")


def own_checkpoint():
    return START.read_text(encoding="utf-8").split("## Your own checkpoint")[1].split("\n## ")[0]


def save_network(path, **inputs):
    """Write a graph that takes inputs of these shapes and answers with twelve zeros."""
    numbers = [helper.make_tensor_value_info(k, TensorProto.FLOAT, v) for k, v in inputs.items()]
    zeros = helper.make_tensor("zeros", TensorProto.FLOAT, [1, 12], [0.0] * 12)
    node = helper.make_node("Constant", [], ["actions"], value=zeros)
    actions = helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])
    graph = helper.make_graph([node], "g", numbers, [actions])
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))


@pytest.fixture
def checkpoint(tmp_path):
    """A graph that takes 48 numbers and an image, where the page copies its checkpoint to."""
    (tmp_path / "my-policy").mkdir()
    path = tmp_path / "my-policy" / "policy.onnx"
    save_network(path, obs=[1, 48], image=[1, 3, 45, 80])
    return path


def paste_card(folder):
    """Write the card of Get started as it stands there."""
    (block,) = re.findall(r"```yaml\n(.*?)```", own_checkpoint(), re.DOTALL)
    lines = block.splitlines()
    assert lines[0] == f"# {folder.name}/policy.yaml"
    (folder / "policy.yaml").write_text("\n".join(lines) + "\n")


def test_the_card_of_get_started_is_valid(tmp_path):
    folder = tmp_path / "my-policy"
    folder.mkdir()
    paste_card(folder)
    specs = {spec.name: spec.shape for spec in check_card(load_card(folder / "policy.yaml"))}
    # 5 x (3 + 3 + 3 + 12 + 12 + 12) numbers, and a picture with its channels first.
    assert specs == {"obs": (225,), "rgb": (3, 45, 80)}


def test_the_first_command_writes_a_card_with_the_digest_and_with_what_to_check(checkpoint):
    commands = re.findall(r"nw-eval (?:policies )?(\w+)", own_checkpoint())
    assert list(dict.fromkeys(commands))[:3] == ["init", "check", "run"]
    told = api.init_policy(checkpoint, robot="go1")
    below = [line for line in told.text.splitlines() if "# CHECK: " in line]
    assert told.to_check == len(below) > 0
    assert load_bundle(checkpoint.parent).checkpoint_sha256 in told.text


def test_the_card_works_as_it_stands_with_a_checkpoint_that_fits_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = Path("my-policy")
    folder.mkdir()
    paste_card(folder)
    save_network(folder / "policy.onnx", obs=[1, 225], image=[1, 3, 45, 80])
    command = re.findall(r"`nw-eval (policies check my-policy)`", own_checkpoint())
    with pytest.raises(SystemExit) as left:
        cli.main(command[0].split())
    out, err = capsys.readouterr()
    assert not err
    assert "rgb          splat_rgb    10800" in out
    # The card is right: what is wrong is the network, which answers zeros to everything.
    assert left.value.code == 2
    assert "fault: the action is the same at every step" in out


def test_what_does_not_fit_is_told_as_the_page_shows_it(checkpoint):
    folder = checkpoint.parent
    paste_card(folder)
    (said,) = re.findall(r"error: my-policy/policy.yaml: (.*)", own_checkpoint())
    with pytest.raises(PolicyError) as told:
        check_bundle(load_bundle(folder))
    assert str(told.value) == f"{folder / 'policy.yaml'}: {said}"


def test_built_in_places_are_called_synthetic_wherever_the_project_introduces_itself(capsys):
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    told = " ".join(capsys.readouterr().out.split())
    described = tomllib.loads((README.parent / "pyproject.toml").read_text())["project"]
    for words in (text(), told, described["description"]):
        assert "synthetic" in words
        assert "photographic" not in words
    # People bring twins of real environments.
    (twins,) = re.findall(r"[^.]*digital twins[^.]*", text(), re.IGNORECASE)
    assert "bring [a scan]" in twins
    assert "digital twin" not in (told + described["description"]).lower()


def test_it_leads_to_the_paper_its_page_and_its_data():
    for place in (
        "https://ziyc.github.io/neverwhere-bench",
        "https://arxiv.org/abs/2609.16443",
        "https://huggingface.co/datasets/ziyc/neverwhere",
    ):
        assert f"]({place})" in text()


def test_it_is_read_in_two_minutes():
    lines = text().splitlines()
    assert len(lines) <= 120
    assert max(map(len, lines)) <= 120
    first = " ".join(text().split("\n\n")[1].split())
    assert first.count(".") == 1, "one sentence says what nw-eval is"
    assert len(START.read_text(encoding="utf-8").splitlines()) <= 200


def test_its_film_is_of_ten_seconds_and_loads_fast():
    assert f"]({FILM.relative_to(ROOT).as_posix()})" in text()
    assert FILM.stat().st_size < 3e6
    lasted = 0
    with Image.open(FILM, formats=["WEBP"]) as film:
        assert film.is_animated
        for frame in range(film.n_frames):
            film.seek(frame)
            film.load()
            lasted += film.info["duration"]
    assert 9_000 <= lasted <= 11_000, "ms"


def test_what_it_says_of_versions_and_scenes_is_so():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == ">=3.11,<3.14"
    for page in (README, START):
        assert "Python 3.11, 3.12 or 3.13" in page.read_text(encoding="utf-8")
    kinds = [name.split("/")[0] for name in names()]
    counted = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counted == {"hurdles": 16, "gaps": 16, "ramps": 16, "stairs": 16, "flat": 1, "open": 3}
    trained = [name for name in names("train") if name.split("/")[0] not in {"flat", "open"}]
    assert f"{len(trained)} of the 64" in START.read_text(encoding="utf-8")


def test_make_run_ends_by_saying_how_to_go_on_and_with_the_code_of_the_run(tmp_path):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").touch()
    (tmp_path / ".installed").touch()  # Last: make installs what is older than its files.
    program = tmp_path / "bin" / "nw-eval"
    program.write_text("#!/bin/sh\necho ran: $*\nexit 3\n")
    program.chmod(0o755)
    ended = subprocess.run(
        # Nothing is installed: what the set-up leaves is there, and newer than its files.
        ["make", "--no-print-directory", "-C", str(ROOT), "run", f"VENV={tmp_path}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "ran: run suites/hurdles.yaml\n" in ended.stdout
    assert (
        ended.stdout.split("ran: ")[1]
        .splitlines()[-1]
        .startswith(f"nw-eval is installed in {tmp_path}: `source {tmp_path}/bin/activate`")
    )
    assert "Error 3" in ended.stderr, "make says the code of the run, and fails"
    assert ended.returncode == 2
