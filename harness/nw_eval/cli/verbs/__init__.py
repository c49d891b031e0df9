"""How arguments become one of the verbs of `table`, or their help."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NoReturn, cast

from nw_base import __version__
from nw_base.errors import PrerequisiteError, UsageError, nearest
from nw_eval.cli.terminal.final_output import tell
from nw_eval.cli.verbs.table import (
    EXAMPLES,
    EXIT_CODES,
    GROUPS,
    OF_EXTRAS,
    OUT_WAS_POSITIONAL,
    RENAMED,
    RENAMED_FLAGS,
    VERBS,
    docs_line,
)

if TYPE_CHECKING:
    from nw_eval.cli.verbs.help import Option

_FENCELESS = ("--in", "--engine", "--allow", "--render")
"""Beginnings of options with which trials run elsewhere, or in processes that are not forked."""
_HELP = frozenset({"-h", "--help"})


def parse(arguments: Sequence[str], *, description: str) -> Callable[[], int]:
    """Return the verb that the arguments name; calling it returns its exit code.

    Raises:
        SystemExit: help was asked for and printed (0), or no verb is named (2).
        UsageError: the arguments are none that the verb takes.
    """
    if list(arguments) == ["--version"]:
        print(f"nw-eval {__version__}")
        raise SystemExit(0)
    if not arguments or arguments[0] in _HELP or list(arguments) == ["help"]:
        print(program_page(description))
        raise SystemExit(0 if arguments else UsageError.exit_code)
    begin(arguments)
    verb, *rest = arguments if arguments[0] != "help" else [*arguments[1:], "--help"]
    if verb in RENAMED:
        _notice(f"nw-eval {verb}", f"nw-eval {RENAMED[verb]}")
        verb = RENAMED[verb]
    if verb not in VERBS:
        _raise_if_of_an_extra(verb)
        known = [*VERBS, "--help", "--version"]
        raise _unknown(f"nw-eval has no command {verb!r}", verb, known, "nw-eval")
    parts = VERBS[verb].parts
    if not parts:
        return _read(verb, resolve(verb), rest, VERBS[verb].examples)
    if not rest or rest[0] in _HELP:
        _family(verb, is_asked=bool(rest))
    part, *rest = rest
    if part not in parts:
        _raise_if_of_an_extra(f"{verb} {part}")
        raise _unknown(f"nw-eval {verb} has no command {part!r}", part, parts, f"nw-eval {verb}")
    return _read(f"{verb} {part}", resolve(verb, part), rest, [parts[part].example])


def _raise_if_of_an_extra(command: str) -> None:
    """Say which extra brings a command, if one does.

    Raises:
        PrerequisiteError: its package is not installed.
    """
    if command in OF_EXTRAS:
        extra = OF_EXTRAS[command]
        raise PrerequisiteError(
            f"nw-eval {command} is of the package nw-{extra}, which is not installed",
            fix=f"pip install 'nw-eval[{extra}]'",
        )


def begin(arguments: Sequence[str]) -> None:
    """Start what trials are forked from, for a command that will most likely run some.

    It imports for as long as the verb does itself and the run is planned, on another core. Where
    the guess is wrong, it ends with this process.
    """
    if len(arguments) < 2 or arguments[0] != "run" or _HELP & set(arguments):
        return
    if not any(word.replace("_", "-").startswith(_FENCELESS) for word in arguments):
        from nw_sim.rollout.confined.start import prepare

        prepare()


def resolve(verb: str, part: str | None = None) -> Any:
    """Return the class of a verb, or of a verb of its family."""
    verb_class = VERBS[verb] if part is None else VERBS[verb].parts[part]
    return resolve_name(f"{verb_class.module}:{verb_class.form}")


def forms() -> Iterator[tuple[str, Any]]:
    """Yield each verb, those of families by two words, with its class."""
    for verb, known in VERBS.items():
        for part in known.parts or (None,):
            yield " ".join(filter(None, (verb, part))), resolve(verb, part)


def program_page(description: str) -> str:
    """Return what `nw-eval --help` prints."""
    lines = ["usage: nw-eval COMMAND [options]", "", description, ""]
    for title, verbs in GROUPS.items():
        lines += [f"{title}:", *(f"  {name:<12}{verb.line}" for name, verb in verbs.items()), ""]
    shown = [f"  {example}" for example in EXAMPLES]
    more = "`nw-eval COMMAND --help` shows a command's options."
    return "\n".join([*lines, "Examples:", *shown, "", EXIT_CODES, "", more, *docs_line()])


def _family(verb: str, *, is_asked: bool) -> NoReturn:
    from nw_eval.cli.verbs.help import family_page

    parts = VERBS[verb].parts
    if not is_asked:
        names = ", ".join(parts)
        raise UsageError(f"nw-eval {verb}: no command", fix=f"give one of {names}")
    lines = [(part, str(resolve(verb, part).__doc__).split("\n")[0]) for part in parts]
    examples = [f"{verb} {name} {part.example}".rstrip() for name, part in parts.items()][:2]
    print(family_page(verb, lines, examples))
    raise SystemExit(0)


def _read(name: str, form: Any, arguments: list[str], examples: Sequence[str]) -> Callable[[], int]:
    """Return a verb of these arguments, or print its help."""
    import tyro

    from nw_eval.cli.verbs.help import options_of, verb_page

    if _HELP & set(arguments):
        print(verb_page(name, form, examples))
        raise SystemExit(0)
    arguments = _under_new_names(name, form, arguments)

    def refuse(event: Any) -> None:
        raise _refusal(name, event, arguments, options_of(form))

    with _errors_to(refuse):
        verb = tyro.cli(
            form,
            args=arguments,
            prog=f"nw-eval {name}",
            config=_config(),
        )
    return cast("Callable[[], int]", verb)


def _config() -> tuple[Any, ...]:
    from tyro import conf

    return (
        conf.FlagCreatePairsOff,
        conf.DisallowNone,  # Who wants none leaves the option out.
        conf.PositionalMetavarFromFieldName,
    )


def _errors_to(refuse: Callable[[Any], None]) -> AbstractContextManager[None]:
    """Let a function raise what is wrong with arguments, in place of tyro's page of it."""
    try:  # No public part of tyro, whose own words come where it is gone.
        return resolve_name("tyro._errors:on_parse_error")(refuse)
    except (ImportError, AttributeError):
        return nullcontext()


def _under_new_names(name: str, form: Any, arguments: Sequence[str]) -> list[str]:
    """Return the arguments with options by their names of today; each other one is told."""
    renamed, given = RENAMED_FLAGS.get(name, {}), list(arguments)
    for place, word in enumerate(given):
        flag, equals, value = word.partition("=")
        if (new_flag := renamed.get(flag.replace("_", "-"))) is not None:
            _notice(flag, new_flag)
            given[place] = f"{new_flag}{equals}{value}"
    if name in OUT_WAS_POSITIONAL and "--out" not in {word.partition("=")[0] for word in given}:
        from nw_eval.cli.verbs.help import options_of

        taking = {flag for option in options_of(form) if option.metavar for flag in option.flags}
        places = [
            place
            for place, word in enumerate(given)
            if not word.startswith("-") and (place == 0 or given[place - 1] not in taking)
        ]
        if len(places) > 1:
            _notice("OUT without an option", "--out OUT")
            given.insert(places[1], "--out")
    return given


def _notice(old: str, new: str) -> None:
    tell(f"notice: {old} is {new} now; the next release takes only that")


def _unknown(what: str, word: str, known: Sequence[str] | Any, command: str) -> UsageError:
    hint = nearest(word, known)
    if not hint.startswith("did you mean"):
        return UsageError(what, fix=f"`{command} --help` lists them")
    return UsageError(what, fix=f"{hint.replace(chr(39), '')} (`{command} --help` lists them)")


def _refusal(
    name: str, event: Any, arguments: Sequence[str], options: Sequence[Option]
) -> UsageError:
    """Return why arguments are refused: the option, its value and what to give."""
    kind, by_name = type(event).__name__, {option.name: option for option in options}
    extra = getattr(event, "tokens", None) or getattr(event, "unrecognized_tokens", None) or []
    flags = [flag for option in options for flag in option.flags]
    marked = [word for word in extra if word[0:1] == "-"]
    for word in [*marked, *(word for word in arguments if word[0:2] == "--" != word)]:
        flag = word.partition("=")[0].replace("_", "-")
        if flag not in flags:
            known = [each for each in flags if each.startswith("--")]
            # What was renamed in another verb is meant here, too, whatever looks more like it.
            names_now = {each[flag] for each in RENAMED_FLAGS.values() if flag in each}
            meant = sorted(names_now.intersection(known)) or [flag]
            what = f"nw-eval {name} has no option {flag}"
            return _unknown(what, meant[0], known, f"nw-eval {name}")
    if extra:
        takes = ", ".join(option.metavar for option in options if not option.flags) or "none"
        fix = f"its arguments: {takes}"
        return UsageError(f"nw-eval {name} takes no argument {extra[0]!r}", fix=fix)
    if kind == "MissingArgs":
        [option, *_] = (by_name[each.arg.field.intern_name] for each in event.missing_arguments)
    elif getattr(event, "argument", None) is not None:
        option = by_name[event.argument.field.intern_name]
    else:
        return UsageError(f"nw-eval {name}: {getattr(event, 'message', kind)}")
    values = [event.value] if kind == "InvalidChoice" else _values(option, arguments)
    flag = option.flags[-1] if option.flags else option.metavar
    if not values and (kind == "MissingArgs" or not option.flags):
        fix = option.help[:1].lower() + option.help[1:].removesuffix(".")
        if option.choices:
            fix = f"give one of {', '.join(option.choices)}"
        return UsageError(f"nw-eval {name}: {option.shown} is missing", fix=fix)
    if not values:
        return UsageError(f"{flag} has no value", fix=f"give {flag} {option.metavar}")
    one_of = f"one of {', '.join(option.choices)}" if option.choices else option.metavar
    fix = {"N": "a whole number", "X": "a number"}.get(option.metavar, one_of)
    return UsageError(f"{flag} {' '.join(values)}", fix=f"give {fix}")


def _values(option: Option, arguments: Sequence[str]) -> list[str]:
    """Return what was given for an option."""
    for place, word in enumerate(arguments):
        flag, equals, value = word.partition("=")
        if flag.replace("_", "-") in option.flags:
            after = arguments[place + 1 : place + 2 + option.metavar.count(" ")]
            stop = next((i for i, each in enumerate(after) if each.startswith("--")), len(after))
            return [value] if equals else list(after[:stop])
    return []
