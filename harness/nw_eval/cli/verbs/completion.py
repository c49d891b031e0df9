"""`nw-eval completion`: what makes a shell complete verbs, options and their words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from shlex import quote
from typing import TYPE_CHECKING, Literal

import tyro

if TYPE_CHECKING:
    from nw_eval.cli.verbs.help import Option


@dataclass(frozen=True, kw_only=True)
class Completion:
    """Print a shell-completion script for commands, options and their choices.

    bash: `nw-eval completion bash > ~/.local/share/bash-completion/completions/nw-eval`.

    zsh: `nw-eval completion zsh > ~/.nw-eval.zsh`, and `source ~/.nw-eval.zsh` in ~/.zshrc.

    fish: `nw-eval completion fish > ~/.config/fish/completions/nw-eval.fish`.
    """

    shell: tyro.conf.Positional[Literal["bash", "zsh", "fish"]]
    """The shell to complete in."""

    def __call__(self) -> int:
        from nw_eval.cli.verbs import forms
        from nw_eval.cli.verbs.help import options_of

        known = {name: options_of(form) for name, form in forms()}
        print("\n".join(_fish(known) if self.shell == "fish" else _bash(known, self.shell)))
        return 0


_BASH = """_nw_eval() {
  local cur="${COMP_WORDS[COMP_CWORD]}" words="" verb="${COMP_WORDS[1]}" from=2
  case "$verb" in %s) verb="$verb ${COMP_WORDS[2]}"; from=3;; esac
  if [ "$COMP_CWORD" -eq 1 ]; then words="%s"
  elif [ "$COMP_CWORD" -lt "$from" ]; then case "${COMP_WORDS[1]}" in
%s
  esac
  else case "$verb ${COMP_WORDS[COMP_CWORD-1]}" in
%s
    *) case "$cur" in -*) case "$verb" in
%s
    esac;; esac;;
  esac; fi
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
}
complete -o default -o bashdefault -F _nw_eval nw-eval"""


def _bash(forms: Mapping[str, tuple[Option, ...]], shell: str) -> Iterator[str]:
    from nw_eval.cli.verbs.table import VERBS

    families = {verb: known.parts for verb, known in VERBS.items() if known.parts}
    chosen = [
        (" | ".join(f'"{name} {flag}"' for flag in option.flags), option)
        for name, options in forms.items()
        for option in options
        if option.choices and option.flags
    ]
    if shell == "zsh":
        yield "autoload -U +X compinit bashcompinit && compinit && bashcompinit"
    yield _BASH % (
        "|".join(families),
        " ".join(VERBS),
        "\n".join(f'    {verb}) words="{" ".join(parts)}";;' for verb, parts in families.items()),
        "\n".join(f'    {keys}) words="{" ".join(option.choices)}";;' for keys, option in chosen),
        "\n".join(
            f'      "{name}") words="{" ".join(flag for each in options for flag in each.flags)}";;'
            for name, options in forms.items()
        ),
    )


_FISH = """function __nw_eval_is
  set -l given (commandline -opc)[2..]
  set -l same $given[1..(count $argv)]
  test "$same" = "$argv"
end"""
"""Says whether the command line begins with these words."""


def _fish(forms: Mapping[str, tuple[Option, ...]]) -> Iterator[str]:
    from nw_eval.cli.verbs.table import VERBS

    begun, first = "complete -c nw-eval -n", "test (count (commandline -opc)) -eq"
    yield _FISH
    for verb, known in VERBS.items():
        yield f"{begun} '{first} 1' -f -a {verb} -d {quote(known.line)}"
        if known.parts:
            yield f"{begun} '__nw_eval_is {verb}; and {first} 2' -f -a '{' '.join(known.parts)}'"
    for name, options in forms.items():
        for option in (option for option in options if option.flags):
            flags = " ".join(f"-{'sl'[each[1] == '-']} {each.lstrip('-')}" for each in option.flags)
            takes = f" -x -a {quote(' '.join(option.choices))}" if option.choices else " -r"
            words = quote(option.help.split(". ")[0].split(";")[0])
            more = f"{takes if option.metavar else ''} -d {words}"
            yield f"{begun} '__nw_eval_is {name}' {flags}{more}"
