"""Output of the command for other programs: JSON, and completion scripts for shells."""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

SHELLS = ("bash", "zsh", "fish")
_BASH = """_viscovib() {{
  local word="${{COMP_WORDS[COMP_CWORD]}}" options=""
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W "{commands} --help --version" -- "$word"))
    return
  fi
  case "${{COMP_WORDS[1]}}" in
{cases}
  esac
  if [[ "$word" == -* ]]; then
    COMPREPLY=($(compgen -W "$options" -- "$word"))
  elif [ "${{COMP_WORDS[1]}}" = completion ]; then
    COMPREPLY=($(compgen -W "{shells}" -- "$word"))
  else
    COMPREPLY=($(compgen -f -X '!*.nml' -- "$word") $(compgen -d -S / -- "$word"))
  fi
}}
complete -o nospace -F _viscovib viscovib
"""


def as_json(content: Any) -> str:
    """Return a line of JSON; infinite numbers and NaN become null, as JSON has none."""
    return json.dumps(_plain(content), ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def script(shell: str, parser: argparse.ArgumentParser) -> str:
    """Return a script that completes commands, options and scene files in a shell."""
    commands = _commands(parser)
    if shell == "fish":
        return _fish(commands)
    cases = "\n".join(
        f'    {name}) options="{" ".join(options)}" ;;' for name, (_, options) in commands.items()
    )
    text = _BASH.format(commands=" ".join(commands), cases=cases, shells=" ".join(SHELLS))
    return f"autoload -U +X bashcompinit && bashcompinit\n{text}" if shell == "zsh" else text


def _fish(commands: dict[str, tuple[str, list[str]]]) -> str:
    lines = ["complete -c viscovib -f"]
    for name, (text, options) in commands.items():
        quoted = text.replace("'", "\\'")
        lines.append(f"complete -c viscovib -n __fish_use_subcommand -a {name} -d '{quoted}'")
        inside = f"complete -c viscovib -n '__fish_seen_subcommand_from {name}'"
        lines += [f"{inside} -l {option.removeprefix('--')}" for option in options]
        what = (
            f"'{' '.join(SHELLS)}'" if name == "completion" else "'(__fish_complete_suffix .nml)'"
        )
        lines.append(f"{inside} -a {what}")
    return "\n".join(lines) + "\n"


def _commands(parser: argparse.ArgumentParser) -> dict[str, tuple[str, list[str]]]:
    """Return the description and the long options of each subcommand."""
    action = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    shown_text = {choice.dest: choice.help or "" for choice in action._choices_actions}
    return {
        name: (
            shown_text[name],
            [o for a in command._actions for o in a.option_strings if o.startswith("--")],
        )
        for name, command in action.choices.items()
    }
