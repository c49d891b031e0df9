"""Foreign words made harmless: one line, printable, bounded.

Names, errors and logs may come from third parties: a checkpoint's message, a scene's name, a
server's answer. Printed raw, an escape sequence repaints a terminal, a line that begins with `::`
gives a CI runner orders, and a bidirectional mark turns a name around. Everything foreign passes
here on its way to a console, a log, a row or a page. Passwords in addresses stay behind.
"""

from __future__ import annotations

import re
import unicodedata

LONGEST = 1000
"""Characters of a foreign text that anybody reads."""

_HARMFUL = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories that draw nothing, or turn or break a line: they are shown as escapes."""
_CREDENTIALS = re.compile(r"(?<=[A-Za-z])(://?)[^\s/?#]*@")  # A path has one slash.
_MORE = " ... and {} more characters"
_HARMLESS = re.compile(r"[\w.,;()+*=<>%/-]+(?: [\w.,;()+*=<>%/-]+)*", re.ASCII)
"""What `clean` returns as it is, and most cells of a table are: without a colon or a `#`."""


def clean(text: object, *, at_most: int = LONGEST) -> str:
    """Return foreign text as one harmless line.

    White space becomes single spaces, invisible characters become visible escapes, what a CI
    runner takes for an order (`::error` at the start of a line, `##[` or `##vso[` anywhere) loses
    that form, and `ws://user:password@host` is `ws://host`.

    Args:
        text: anything; its `str` is meant.
        at_most: characters that are kept; how many were cut is said.
    """
    whole = str(text)
    if len(whole) <= at_most and _HARMLESS.fullmatch(whole):
        return whole
    # More than this is never looked at: the text may be millions of characters long.
    line = " ".join(whole[: 4 * at_most].split())
    line = "".join(_visible(character) for character in line)
    line = without_credentials(line)
    line = re.sub(r"^::", r"\\x3a:", line)
    line = re.sub(r"##(?=\w*\[)", r"#\\x23", line)
    if len(line) <= at_most and len(whole) <= 4 * at_most:
        return line
    kept = line[:at_most]
    return kept + _MORE.format(max(len(whole) - len(kept), 1))


def message_of(error: BaseException) -> str:
    """Return what a foreign exception says of itself, harmless; even that may fail."""
    try:
        return clean(error)
    except BaseException as another:  # noqa: BLE001 - its `__str__` is foreign code too.
        return f"its own message cannot be read, because of {type(another).__name__}"


def without_credentials(text: str) -> str:
    """Return a text whose addresses name no user and no password."""
    return _CREDENTIALS.sub(r"\1", text)


def _visible(character: str) -> str:
    if character.isascii():
        return character if character.isprintable() else f"\\x{ord(character):02x}"
    if unicodedata.category(character) in _HARMFUL:
        return f"\\u{ord(character):04x}"
    return character
