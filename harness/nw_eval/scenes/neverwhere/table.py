"""The published table of scenes: task, and by how much a trial may move waypoints.

Source: `scenes.txt` of ziyc/neverwhere, commit 5774a18; the misspelling `hurldes` is its own. The
noise has no effect in the published evaluation and acts under `strict`. LucidSim's terrains, which
are XML files of boxes, have theirs from its environments' registration, where it acts.
"""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.words import Task


@dataclass(frozen=True, kw_only=True)
class Row:
    """Task, and half widths in metres of the waypoint noise along x and y."""

    task: Task
    waypoint_noise: tuple[float, float]


_ROWS: tuple[tuple[Task, float, float, str], ...] = (
    ("gaps", 0.00, 0.30, "gaps_12in_226_blue_carpet_v2 gaps_16in_226_blue_carpet_v2"),
    ("gaps", 0.00, 0.30, "gaps_grassy_courtyard_v2 gaps_stata_v1"),
    ("gaps", 0.10, 0.15, "gaps_atkinson_back_12in gaps_center_12in gaps_fah_front_12in"),
    ("gaps", 0.10, 0.15, "gaps_fah_ll_indoor_12in gaps_jacobs_front_12in"),
    ("gaps", 0.10, 0.20, "gaps_geisel_12in gaps_jacobs_side_12in"),
    ("gaps", 0.00, 0.10, "gaps_fah_ll_gaps_15in_indoor_mixtex_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_226_blue_carpet_v3 hurdle_one_dark_grassy_courtyard_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_fah_ll_two_hurldes_wood_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_fah_two_hurdle_gray_ground_v1 test_real_robot_sample_1"),
    ("hurdles", 0.00, 0.35, "hurdle_one_blue_carpet_v2 hurdle_stata_v1 hurdle_stata_v2"),
    ("hurdles", 0.00, 0.35, "hurdle_pfb_side hurdle_jacobs_side"),
    ("hurdles", 0.00, 0.40, "hurdle_black_stone_v1 hurdle_three_grassy_courtyard_v2"),
    ("hurdles", 0.00, 0.40, "real_hurdle_three_grassy_ally_v2 hurdle_pssl_side"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_back_two_hurldes_wood_v1"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_indoor_two_hurdle_rubber_v1"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_indoor_two_hurdle_wood_v1"),
    ("hurdles", 0.00, 0.10, "lucidsim_real_hurdle_1 lucidsim_real_hurdle_2"),
    ("stairs", 0.00, 0.50, "building_31_stairs_v1 real_stair_02_bcs_v1 real_stair_04_bcs_dusk"),
    ("stairs", 0.00, 0.50, "real_stair_08_mc_afternoon_v1 stairs_4_stairs2up_v1"),
    ("stairs", 0.00, 0.50, "stairs_atkinson_back stairs_fah_back stairs_atkinson_side"),
    ("stairs", 0.00, 0.50, "stairs_ewc_front stairs_pc_fountain stairs_pfbh_front"),
    ("stairs", 0.00, 0.40, "stairs_36_backstairs_v2 stairs_48_v3"),
    ("stairs", 0.00, 0.30, "stairs_geisel_up stairs_jacobs_front stairs_pc_side stairs_pcw"),
    ("stairs", 0.00, 0.10, "lucidsim_real_stairs_2 lucidsim_real_stairs_3"),
    ("ramps", 0.00, 0.15, "wood_ramp_aligned_bricks_v1 wood_ramp_offset_bricks_v2"),
    ("ramps", 0.00, 0.15, "ramp_aligned_blue_carpet_v4 ramp_spread_blue_carpet_v5"),
    ("ramps", 0.15, 0.20, "wood_ramp_aligned_grass_v2"),
    ("ramps", 0.00, 0.30, "ramp_bricks_v2 ramp_grass_v3"),
    ("ramps", 0.15, 0.15, "ramp_atkinson_back ramp_fah_back ramp_fah_garden ramp_fah_side"),
    ("ramps", 0.15, 0.15, "ramp_fah_indoor_wood_4_ramp_v1 ramp_geisel ramp_jacobs_back"),
    ("ramps", 0.15, 0.15, "ramp_jacobs_front ramp_jacobs_indoor ramps_fah_ll_indoor"),
)

PUBLISHED: dict[str, Row] = {
    name: Row(task=task, waypoint_noise=(x, y))
    for task, x, y, names in _ROWS
    for name in names.split()
}

LUCIDSIM: dict[str, Row] = {
    "hurdle": Row(task="hurdles", waypoint_noise=(0.0, 0.1)),
    "gaps": Row(task="gaps", waypoint_noise=(0.0, 0.1)),
    "parkour": Row(task="ramps", waypoint_noise=(0.1, 0.1)),
    "stairs_v1": Row(task="stairs", waypoint_noise=(0.0, 0.1)),
    "stairs_v2": Row(task="stairs", waypoint_noise=(0.0, 0.1)),
}
"""By the name of the XML, without its suffix."""

_WORDS: tuple[tuple[str, Task], ...] = (
    ("hurdle", "hurdles"),
    ("hurlde", "hurdles"),
    ("stair", "stairs"),
    ("ramp", "ramps"),
    ("parkour", "ramps"),
    ("gap", "gaps"),
)


def row_of(name: str) -> tuple[Row, bool]:
    """Return the row of a scene and whether it is the published one, not guessed from the name."""
    for rows in (PUBLISHED, LUCIDSIM):
        if name in rows:
            return rows[name], True
    for word, task in _WORDS:
        if word in name.lower():
            return Row(task=task, waypoint_noise=(0.0, 0.1)), False
    return Row(task="hurdles", waypoint_noise=(0.0, 0.1)), False
