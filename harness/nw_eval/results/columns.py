"""The columns of trials.parquet: name, type, and what each one says.

This is where they are told. The file's own schema carries the words (`about`, in the metadata of
each field), and docs/results.md repeats them, which a test compares.
"""

from __future__ import annotations

import pyarrow as pa

_WORD = pa.dictionary(pa.int32(), pa.string())
_TEXT, _REAL, _WHOLE = pa.string(), pa.float64(), pa.int32()


def _column(name: str, kind: pa.DataType, about: str, *, nullable: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=nullable, metadata={"about": about})


SCHEMA = pa.schema(
    [
        _column("trial_id", _TEXT, "the trial's name: scene, index and perturbation"),
        _column("suite", _WORD, "the suite's name"),
        _column("scene", _WORD, "the scene's name"),
        _column("task", _WORD, "what the scene asks for: hurdles, gaps, ramps, stairs, flat"),
        _column("seed_index", _WHOLE, "number of the start in its scene, from 0"),
        _column("seed", pa.uint64(), "the trial's seed; the same for every policy"),
        _column("policy", _WORD, "the policy's name"),
        _column(
            "arm",
            _WORD,
            "`candidate`: the policy that is judged, and so far every row; `baseline` is kept for "
            "one that it is compared with",
        ),
        _column("attempt", _WHOLE, "which attempt this is: 1, or more after an error"),
        _column(
            "perturbation",
            pa.map_(pa.string(), pa.float64()),
            "what was changed, by the name of the axis (`friction`), and to which value",
        ),
        _column("status", _WORD, "`ok`: a result, counted; `error`: none, and counted apart"),
        _column("outcome", _WORD, "how the trial ended; see *Outcomes* and *Errors*"),
        _column(
            "end_reason",
            _WORD,
            "what decided the outcome, such as `roll` or `contact face`; of a policy that failed, "
            "how; `error` for the machine's faults",
        ),
        _column("completed", pa.bool_(), "whether all waypoints were reached"),
        _column(
            "success",
            _REAL,
            "share of the trail's waypoints reached, 0 to 1: what is averaged and judged; none for "
            "an error, so that nobody averages it in",
            nullable=True,
        ),
        _column("waypoints_reached", _WHOLE, "number of waypoints reached, in their order"),
        _column("waypoints_total", _WHOLE, "number of waypoints of the trail"),
        _column("waypoint_times", pa.list_(pa.float32()), "when each was reached, simulated s"),
        _column("steps", _WHOLE, "control steps done, 50 in a simulated second"),
        _column("sim_s", _REAL, "simulated s"),
        _column("physics_s", _REAL, "wall s spent on physics"),
        _column("render_s", _REAL, "wall s spent on camera images, for the policy or the log"),
        _column("policy_s", _REAL, "wall s spent on the policy"),
        _column("log_s", _REAL, "wall s spent on the log, but for rendering"),
        _column("wall_s", _REAL, "wall s of all of the trial, sensors and set-up included"),
        _column(
            "coverage_min",
            _REAL,
            "smallest share, 0 to 1, of a camera image of the policy's that the splat covers: far "
            "below 1, the robot looked where nothing was captured; none without such images",
            nullable=True,
        ),
        _column(
            "coverage_mean",
            _REAL,
            "mean share over all those images; none without them",
            nullable=True,
        ),
        _column(
            "state_digest",
            _TEXT,
            "SHA-256 over all states: equal ones are equal trajectories, bit for bit",
        ),
        _column("action_digest", _TEXT, "SHA-256 over all applied actions, likewise"),
        _column("checkpoint_digest", _TEXT, "SHA-256 of the checkpoint, or of the policy's code"),
        _column("scene_digest", _TEXT, "SHA-256 of what the scene is made of"),
        _column(
            "cached",
            pa.bool_(),
            "whether the row was taken over from another run, so that its times are none of this "
            "run's; so far never",
        ),
        _column("host", _WORD, "the machine's name"),
        _column("mcap_path", _TEXT, "the log within the run's folder; empty without one"),
        _column("mcap_bytes", pa.int64(), "size of the log, bytes"),
        _column("error_type", _WORD, "kind of the error, also of a policy that failed; or empty"),
        _column("error_text", _TEXT, "what went wrong, in one line; or empty"),
        _column("contact_s", _REAL, "simulated s with head or trunk in contact"),
        _column("robot", _WORD, "which robot: go1, go2"),
        _column("tier", _WORD, "how much the scene counts: critical, supporting, informational"),
        _column("setup_s", _REAL, "wall s before the first step: scene, world and policy"),
        _column("sense_s", _REAL, "wall s spent on observations that are no images"),
    ]
)
"""The columns in the order of the file."""


def columns_table() -> str:
    """Return the columns as the Markdown table of docs/results.md."""
    lines = ["| column | type | what |", "|---|---|---|"]
    lines += [f"| `{field.name}` | {_kind(field)} | {about(field.name)} |" for field in SCHEMA]
    return "\n".join(lines) + "\n"


def about(name: str) -> str:
    """Return what a column says, in words."""
    return SCHEMA.field(name).metadata[b"about"].decode()


def _kind(field: pa.Field) -> str:
    kind = str(field.type.value_type if pa.types.is_dictionary(field.type) else field.type)
    return f"{kind} or none" if field.nullable else kind
