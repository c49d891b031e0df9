"""Rows as the JSON that is written and hashed: a column at a time, once for all that needs it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import chain
from json.encoder import encode_basestring_ascii
from typing import Any

from nw_eval.results.row.column import Column, Numbers
from nw_eval.results.row.row import (
    AT_ONCE,
    CALLED,
    CAME_LATER,
    COLUMNS,
    OF_THE_RESULT,
    Row,
    by_column,
)

_FEW = 8  # values for each different one, from which on each is encoded once
_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
_LINES = json.JSONEncoder(separators=("\n", ":"), allow_nan=False).encode
"""JSON holds no line's end but between values: a column of it can be split into those."""

_DIGESTED = tuple(
    sorted((CALLED.get(name, name), name) for name in OF_THE_RESULT if name not in CAME_LATER)
)
_RECORD = '{"row":{' + ",".join(f'"{name}":%s' for name in COLUMNS) + "}}"
_DIGEST = "{" + ",".join(f'"{word}":%s' for word, _ in _DIGESTED) + "}"

Result = tuple[str, str, str]
"""A row's trial, arm and digest."""


@dataclass(frozen=True)
class RowTexts:
    """Some rows, and the JSON of each of their values, by column in the order of the file."""

    rows: Sequence[Row]
    values: Mapping[str, Sequence[Any]]
    texts: Mapping[str, Sequence[str]]

    def records(self) -> Iterator[str]:
        """Return each row as a line of the journal has it, without its sum."""
        return map(_RECORD.__mod__, zip(*self.texts.values(), strict=True))

    def results(self) -> Iterator[Result]:
        """Return what `digest_of_results` takes."""
        return zip(self.values["trial_id"], self.values["arm"], self._digests(), strict=True)

    def _digests(self) -> list[str]:
        """Return the `digest` of each row."""
        for name in CAME_LATER:
            if any(map(COLUMNS[name].in_digest, self.values[name])):
                return [row.digest for row in self.rows]
        texts = {**self.texts, "error_text": self._error_texts()}
        columns = (texts[name] for _, name in _DIGESTED)
        return [
            sha256((_DIGEST % of_row).encode()).hexdigest() for of_row in zip(*columns, strict=True)
        ]

    def _error_texts(self) -> Sequence[str]:
        """Return what digests have of them: nothing of what a policy said as it failed."""
        texts, outcomes = self.texts["error_text"], self.values["outcome"]
        if "policy_failed" not in outcomes:
            return texts
        pairs = zip(texts, outcomes, strict=True)
        return ['""' if outcome == "policy_failed" else text for text, outcome in pairs]


def rows_digest(rows: Iterable[Row]) -> str:
    """Return one hex sha256 for a set of rows, whatever their order and wall times."""
    portions = texts_of(list(rows))
    return digest_of_results(chain.from_iterable(texts.results() for texts in portions))


def digest_of_results(results: Iterable[Result]) -> str:
    """Return the `rows_digest` of rows of which all that it covers is known."""
    return sha256(json.dumps(sorted(results)).encode()).hexdigest()


def texts_of(rows: Sequence[Row]) -> Iterator[RowTexts]:
    """Yield rows in portions, in their order."""
    for first in range(0, len(rows), AT_ONCE):
        some = rows[first : first + AT_ONCE]
        values = by_column(some)
        texts = {name: _encoded(values[name], column) for name, column in COLUMNS.items()}
        yield RowTexts(some, values, texts)


def _encoded(values: Sequence[Any], column: Column) -> Sequence[str]:
    """Return the JSON of each value of a column."""
    if column.types is str:
        return _encoded_words(values)
    if not column.is_list:
        return _LINES(values)[1:-1].split("\n")
    if column.kind == Numbers:
        return [f"[{numbers}]" for numbers in _ENCODE(values)[2:-2].split("],[")]
    return [_ENCODE(value) if value else "[]" for value in values]


def _encoded_words(words: Sequence[str]) -> Sequence[str]:
    distinct = set(words)
    if _FEW * len(distinct) > len(words):
        return list(map(encode_basestring_ascii, words))
    encoded = {word: encode_basestring_ascii(word) for word in distinct}
    return [encoded[word] for word in words]
