"""Episodes of an evaluation by any simulator, read from the file that it wrote.

An episode has a task, a score between 0 and 1, and mostly a start: the seed or initial state by
which it can be compared with the same episode of another policy. Read are

    .parquet, .csv, .tsv, .jsonl    a line for each episode; columns are known by their names
    .json                           a list of episodes; LeRobot's eval_info.json; logs of
                                    inspect_ai; averages of robomimic's run_trained_agent.py
    .eval                           logs of inspect_ai, as it packs them

Of rows of nw-eval (`trials.parquet`) the columns `scene`, `seed_index` and `success` are taken.

Sources: LeRobot, `lerobot_eval.py` (`per_episode`, later `per_task` with lists of `successes`);
inspect_ai, `EvalLog` version 2 (`samples[].scores[].value`, C, P and I for 1, 0.5 and 0);
robomimic, `run_trained_agent.py` (`Success_Rate` and `Num_Success`).
"""

from __future__ import annotations

import csv
import io
import json
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from nw_base.clean import clean
from nw_base.errors import UsageError, nearest
from nw_base.files.inside import bounded_bytes

_MOST_BYTES = 256 * 2**20
_MOST_EPISODES = 1_000_000
_ONE_TASK = "all"
"""What the task is called where a file names none."""

SCORES = (
    *("success", "is_success", "successes", "task_success", "success_once", "success_at_end"),
    *("succeeded", "score", "success_rate"),
)
"""Names by which a score is known, the first one that a file has."""
TASKS = ("task", "task_name", "task_id", "scene", "env", "env_id", "env_name", "environment")
"""Names by which a task is known; several columns together name it where `task_id` is a number."""
STARTS = (
    *("start", "seed_index", "init_state_id", "init_state", "init_index", "initial_state"),
    "episode_id",
    *("episode_ix", "episode_index", "episode", "episode_idx", "trial", "seed", "run", "epoch"),
)
"""Names by which a start is known: the first ones that together tell the episodes of a task
apart."""

_GRADES = {"C": 1.0, "P": 0.5, "I": 0.0, "N": 0.0}
"""What inspect_ai's scorers call correct, partially correct, incorrect and no answer."""


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode.

    Attributes:
        task: what was to be done, or where.
        score: 0 to 1; None where the file has none.
        start: what tells it from other episodes of the task; None where nothing does.
    """

    task: str
    score: float | None
    start: str | None


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Which columns of a file are meant, where names do not say it.

    Attributes:
        score: of the score; one of `SCORES` if None.
        task: of the task, several with commas; one of `TASKS` if None.
        start: of the start, several with commas; some of `STARTS` if None.
        part: of a JSON file that holds several evaluations, the key of the one that is meant.
        span: the score's least and greatest value, which become 0 and 1.
    """

    score: str | None = None
    task: str | None = None
    start: str | None = None
    part: str | None = None
    span: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The episodes of one policy, in the order of their file.

    Attributes:
        name: of the policy, for people: the file's.
        score: what the score is called in the file.
        episodes: all of them.
    """

    name: str
    score: str
    episodes: tuple[Episode, ...]


def read_evaluation(path: str | Path, columns: Columns | None = None) -> Evaluation:
    """Read the episodes of an evaluation.

        read_evaluation("eval_info.json").episodes[0]
        Episode(task='libero_spatial/0', score=1.0, start='0')

    Args:
        path: the file that a simulator's evaluation wrote.
        columns: what its columns are called, where names do not say it.

    Raises:
        UsageError: it is no such file, or a column that is needed is not there.
        StoreError: it is damaged.
    """
    path, wanted = Path(path), columns or Columns()
    try:
        records = _records(path, wanted)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from error
    except (
        *(ValueError, KeyError, TypeError, AttributeError, RecursionError),
        *(csv.Error, zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError),
    ) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise UsageError(f"{path} is not an evaluation that nw-gate can read: {reason}") from None
    if not records:
        raise UsageError(f"{path} has no episodes")
    if len(records) > _MOST_EPISODES:
        raise UsageError(f"{path} has {len(records)} episodes, over {_MOST_EPISODES}")
    return _evaluation(path, records, wanted)


def _records(path: Path, wanted: Columns) -> list[Mapping[str, Any]]:
    """Return a mapping for each episode."""
    suffix = path.suffix.lower()
    if suffix == ".parquet":
        from nw_gate.results.tables import read_foreign_table

        table = read_foreign_table(path, fix="name the Parquet file of an evaluation")
        return [
            dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)
        ]
    if suffix == ".eval":
        return list(_packed(path))
    text = _text(bounded_bytes(path, _MOST_BYTES))
    if suffix in {".csv", ".tsv"}:
        return list(_lines(text))
    if suffix in {".jsonl", ".ndjson"}:
        return [_mapping(json.loads(line)) for line in text.splitlines() if line.strip()]
    if suffix == ".json":
        return list(_of_json(json.loads(text), path, wanted.part))
    raise UsageError(
        f"{path}: nw-gate does not read {suffix or 'a file without suffix'}",
        fix="give .parquet, .csv, .tsv, .jsonl, .json or .eval",
    )


def _text(data: bytes) -> str:
    return data.decode("utf-16" if data[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig")


def _lines(text: str) -> Iterator[Mapping[str, Any]]:
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    for line in reader:
        if None in line:
            raise ValueError(f"line {reader.line_num} has more cells than the heading")
        if any(line.values()):
            yield {str(name).strip(): (value or "").strip() for name, value in line.items()}


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError(f"an episode is {type(value).__name__}, no mapping")
    return cast("Mapping[str, Any]", value)


def _of_json(value: Any, path: Path, part: str | None) -> Iterator[Mapping[str, Any]]:
    """Yield the episodes of a JSON file, whatever wrote it."""
    for key in [] if part is None else part.split("/"):
        held = _mapping(value)
        if key not in held:
            raise UsageError(f"{path} has no {part!r}", fix=nearest(key, [*held]))
        value = held[key]
    if isinstance(value, list):
        yield from map(_mapping, cast("list[Any]", value))
        return
    held = _mapping(value)
    if isinstance(held.get("per_task"), list):  # LeRobot, since there are many tasks.
        for task in map(_mapping, held["per_task"]):
            yield from _of_lerobot(task)
    elif isinstance(held.get("per_episode"), list):
        yield from map(_mapping, held["per_episode"])
    elif isinstance(held.get("samples"), list):
        yield from (_of_inspect(_mapping(sample), held) for sample in held["samples"])
    elif "Success_Rate" in held and "Num_Success" in held:
        yield from _of_averages(held)
    else:
        yield from _of_unknown(held, path)


def _of_unknown(held: Mapping[str, Any], path: Path) -> Iterator[Mapping[str, Any]]:
    """Yield the episodes of a mapping that has one list of them, or one evaluation, at any key."""
    listed = [name for name, each in held.items() if _is_list_of_mappings(each)]
    parts = [name for name, each in held.items() if isinstance(each, Mapping)]
    if len(listed) == 1:
        yield from held[listed[0]]
    elif not listed and len(parts) == 1:
        yield from _of_json(held[parts[0]], path, None)
    else:
        known = ", ".join([*listed, *parts][:12])
        raise UsageError(
            f"{path} holds several evaluations, or none",
            fix=f"name one with --part: {known}" if known else "give a list of episodes",
        )


def _is_list_of_mappings(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _of_lerobot(task: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the episodes of one task, of which each metric has a list."""
    name = "/".join(str(task[key]) for key in ("task_group", "task_id") if key in task)
    metrics = _mapping(task["metrics"])
    lists = {key: values for key, values in metrics.items() if isinstance(values, list) and values}
    count = len(lists.get("successes") or next(iter(lists.values()), []))
    for index in range(count):
        yield {
            "task": name or _ONE_TASK,
            "episode_ix": index,
            **{
                key.removesuffix("es") if key == "successes" else key.removesuffix("s"): each[index]
                for key, each in lists.items()
                if len(each) == count
            },
        }


def _of_inspect(sample: Mapping[str, Any], log: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a sample of inspect_ai as an episode: its epoch is its start's, too."""
    scores = _mapping(sample.get("scores") or {})
    values = {name: _mapping(score).get("value") for name, score in scores.items()}
    graded = {
        name: _GRADES.get(value, value) if isinstance(value, str) else value
        for name, value in values.items()
    }
    task = _mapping(log.get("eval") or {}).get("task") or _ONE_TASK
    fields = {"task": task, "episode": f"{sample.get('id')}:{sample.get('epoch', 1)}", **graded}
    return {**fields, "score": next(iter(graded.values()))} if len(graded) == 1 else fields


def _of_averages(held: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield as many episodes as an average was made of; which of them succeeded it does not say."""
    share, count = float(held["Success_Rate"]), round(float(held["Num_Success"]))
    if not (0.0 < share <= 1.0 and count >= 1):
        raise ValueError(
            "an average of 0 does not say over how many episodes it was taken; give the episodes"
        )
    total = round(count / share)
    if abs(count / total - share) > 1e-3:
        raise ValueError(f"Success_Rate {share:g} is not Num_Success {count} of any number")
    yield from ({"success": index < count} for index in range(total))


def _packed(path: Path) -> Iterator[Mapping[str, Any]]:
    """Yield the samples of a packed log of inspect_ai."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        head = "header.json" if "header.json" in names else "_journal/start.json"
        if sum(info.file_size for info in archive.infolist()) > _MOST_BYTES:
            raise ValueError(f"it unpacks to over {_MOST_BYTES // 2**20} MiB")
        log = _mapping(json.loads(archive.read(head)))
        for name in names:
            if name.startswith("samples/") and name.endswith(".json"):
                yield _of_inspect(_mapping(json.loads(archive.read(name))), log)


def _evaluation(path: Path, records: Sequence[Mapping[str, Any]], wanted: Columns) -> Evaluation:
    known = list(dict.fromkeys(name for record in records for name in record))
    score = _score_column(path, known, wanted)
    tasks = _asked(path, "task", wanted.task, known)
    if tasks is None:
        tasks = [name for name in known if name.lower() in TASKS][:1]
        if tasks == ["task_id"] and "task_group" in known:
            tasks = ["task_group", "task_id"]
    names = ["/".join(str(record.get(name)) for name in tasks) or _ONE_TASK for record in records]
    starts = _asked(path, "start", wanted.start, known)
    if starts is None:
        starts = _telling_apart(records, names, known, {score, *tasks})
    elif not _tells_apart(records, names, starts):
        raise UsageError(
            f"{path}: {', '.join(starts)} does not tell the episodes of a task apart",
            fix="name more columns with --start, with commas between them",
        )
    episodes = tuple(
        Episode(
            task=name,
            score=_score(path, number, record.get(score), score, wanted.span),
            start=_key(record, starts) if starts else None,
        )
        for number, (record, name) in enumerate(zip(records, names, strict=True), 1)
    )
    part = f":{wanted.part}" if wanted.part else ""
    return Evaluation(name=f"{path}{part}", score=score, episodes=episodes)


def _score_column(path: Path, known: Sequence[str], wanted: Columns) -> str:
    if wanted.score is not None:
        _asked(path, "score", wanted.score, known)
        return wanted.score
    lower = {name.lower(): name for name in reversed(known)}
    for name in SCORES:
        if name in lower:
            return lower[name]
    raise UsageError(
        f"{path} has no column that is known to be a score",
        fix=f"name it with --score; it has {', '.join(known[:12])}",
    )


def _asked(path: Path, what: str, names: str | None, known: Sequence[str]) -> list[str] | None:
    """Return the columns that were asked for, or None; raises UsageError where one is not there."""
    if names is None:
        return None
    columns = [name.strip() for name in names.split(",")] if what != "score" else [names]
    for name in columns:
        if name not in known:
            raise UsageError(f"{path} has no column {name!r}", fix=nearest(name, known))
    return columns


def _telling_apart(
    records: Sequence[Mapping[str, Any]],
    names: Sequence[str],
    known: Sequence[str],
    others: set[str],
) -> list[str]:
    """Return the first columns that tell episodes apart and are starts by their names."""
    lower = {name.lower(): name for name in reversed(known) if name not in others}
    candidates = [lower[name] for name in STARTS if name in lower]
    for name in candidates:
        if _tells_apart(records, names, [name]):
            return [name]
    for index, name in enumerate(candidates):
        for other in candidates[index + 1 :]:
            if _tells_apart(records, names, [name, other]):
                return [name, other]
    return []


def _tells_apart(
    records: Sequence[Mapping[str, Any]], names: Sequence[str], columns: Sequence[str]
) -> bool:
    keys = {(name, _key(record, columns)) for record, name in zip(records, names, strict=True)}
    return len(keys) == len(records)


def _key(record: Mapping[str, Any], columns: Iterable[str]) -> str:
    return "/".join(str(record.get(name)) for name in columns)


_WORDS = {"true": 1.0, "yes": 1.0, "success": 1.0, "false": 0.0, "no": 0.0, "failure": 0.0}
_NONE = {"", "nan", "none", "null", "n/a", "na"}


def _score(
    path: Path, number: int, value: Any, column: str, span: tuple[float, float]
) -> float | None:
    """Return a score from 0 to 1; None where there is none.

    Raises:
        UsageError: it is neither a number within the span nor a word for success or failure.
    """
    if isinstance(value, str):
        word = value.strip().lower()
        if word in _NONE:
            return None
        value = _WORDS.get(word, value)
    if value is None:
        return None
    low, high = span
    try:
        number_of = float(value)
    except (TypeError, ValueError):
        raise UsageError(
            f"{path}, episode {number}: {column} {clean(value, at_most=40)!r} is not a number",
            fix="name another column with --score",
        ) from None
    if math.isnan(number_of):
        return None
    if isinstance(value, bool) or ((low, high) == (0.0, 1.0) and number_of in {0.0, 1.0}):
        return number_of
    scaled = (number_of - low) / (high - low)
    if not 0.0 <= scaled <= 1.0:
        raise UsageError(
            f"{path}, episode {number}: {column} {number_of:g} is not between {low:g} and {high:g}",
            fix="say the least and greatest value that it can have with --range LOW,HIGH",
        )
    return scaled
