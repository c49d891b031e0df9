"""What a test's report says besides: the properties of its JUnit test case."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api import RunReport
    from nw_eval.reporting.scene_states import SceneState

Properties = list[tuple[str, object]]


def verdict_properties(judged: RunReport) -> Properties:
    """Return those of the verdict: its figures, where they come from, and where the page is."""
    from nw_eval.reporting.headline import headline
    from nw_eval.reporting.junit.properties import run_properties

    return [
        *run_properties(judged.info, judged.verdict).items(),
        ("headline", headline(judged.verdict, judged.info)),
        ("report", str(judged.typed_page or judged.typed_folder)),
    ]


def scene_properties(judged: RunReport, state: SceneState) -> Properties:
    """Return those of a scene: its figures, and those of the run that they come from."""
    from nw_eval.reporting.junit.properties import scene_properties as of_scene
    from nw_eval.reporting.tables.trials import worst_trials

    rows = [row for row in judged.rows if row.scene == state.scene]
    return [
        *of_scene(state, rows, worst_trials(rows)).items(),
        ("run", judged.info.id),
        ("report", str(judged.typed_page or judged.typed_folder)),
    ]
