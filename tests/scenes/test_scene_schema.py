"""`nw-eval schema scene` and `schema collision`: what an editor completes is what the reader takes.

The reader itself makes the schema, so bounds and defaults cannot differ; what could is said here.
"""

import json
from typing import Any

import pytest

from nw_eval import api, cli
from nw_sim.catalogue import get_scene


def read(kind: Any) -> dict[str, Any]:
    return api.schema(kind)


def test_both_files_have_a_schema_with_all_that_a_folder_can_say() -> None:
    assert set(read("scene")["properties"]) == {
        *("nw-scene", "name", "task", "title", "licence", "units", "trail", "spawn"),
        *("waypoint_noise", "ground", "collision", "splat", "rasterize_mode"),
        *("T_world_splat", "captures", "props"),
    }
    assert set(read("scene")["required"]) == {"nw-scene", "name", "task", "licence", "trail"}
    box = read("collision")["$defs"]["_Box"]
    assert set(box["properties"]) == {
        *("center", "half_size", "quat", "friction", "material", "kind"),
    }
    assert set(box["required"]) == {"center", "half_size"}


@pytest.mark.parametrize("kind", ["scene", "collision", "ladder"])
def test_an_editor_can_explain_every_key_and_refuse_others(kind: str) -> None:
    schema = read(kind)
    for name, part in {kind: schema, **schema["$defs"]}.items():
        assert part["additionalProperties"] is False
        for key, stated in part["properties"].items():
            assert stated.get("description", "").strip(), f"{name}.{key}"


def test_what_the_schema_calls_needed_is_enough(tmp_path) -> None:
    needed = {"nw-scene": 1, "name": "mine", "task": "gaps", "licence": "MIT", "trail": [[2, 0, 0]]}
    assert set(needed) == set(read("scene")["required"])
    (tmp_path / "scene.yaml").write_text(json.dumps(needed))
    box = {"center": [2, 0, -0.1], "half_size": [1, 1, 0.1]}
    (tmp_path / "collision.yaml").write_text(json.dumps({"boxes": [box]}))
    assert len(get_scene(tmp_path).solids) == 1


@pytest.mark.parametrize("kind", ["suite", "policy", "scene", "collision", "ladder"])
def test_the_command_writes_it(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        cli.main(["schema", kind])
    assert not left.value.code
    assert json.loads(capsys.readouterr().out) == read(kind)
