"""Write docs/cli.md from the commands: options that several commands share are described once."""

import inspect
import re
from collections import Counter
from pathlib import Path

import click

from mocap_calib_cli.main import group

PAGE = Path(__file__).with_name("cli.md")
_ABOUT = """\
# Command line

Made by `make cli-docs`; `mocap-calib COMMAND --help` has the same texts. The shell completes
commands, options and names of formats ([how](completion.md)).

## Exit status

| status | when |
|---|---|
| 0 | done; also a *weak* rig, with a warning that `--quiet` does not silence |
| 1 | files or data are refused: one line on stderr has the reason and the remedy |
| 1 | the rig is *not determined* (`run`, `batch`, `adjust`), unless `--accept not-determined` |
| 1 | `--strict` and the rig is *weak* (`run`, `batch`, `adjust`, `verify`) |
| 1 | a camera is named, or the keypoints do not determine the rig (`verify`) |
| 1 | a recording failed (`batch`); a finding is CRITICAL (`inspect`) |
| 2 | the command line is wrong |
| 130 | interrupted |

All files are written before the verdict sets the status; `OUT/run.json` is absent where data are
refused. Of several groups of cameras the largest sets the status. In Python, `calibrate` raises an
error where data are refused, not for a verdict.
"""


def make_page() -> str:
    """Return the whole page as Markdown."""
    commands = {name: group.get_command(click.Context(group), name) for name in group.commands}
    options = {name: describe_options(command) for name, command in commands.items()}
    uses = Counter(text for texts in options.values() for text in texts.values())
    shared = {text for text, number in uses.items() if number > 1}
    lines = [_ABOUT, "## Options of several commands", ""]
    lines += dict.fromkeys(x for texts in options.values() for x in texts.values() if x in shared)
    for name, command in commands.items():
        own = [text for text in options[name].values() if text not in shared]
        others = [f"`{option}`" for option, text in options[name].items() if text in shared]
        lines += ["", f"## mocap-calib {name}", "", describe_command(name, command), "", *own]
        lines += ["", f"Shared: {', '.join(others)}."] if others else []
    return "\n".join(lines) + "\n"


def describe_options(command: click.Command) -> dict[str, str]:
    """Return an item of a list for each option of a command, by its longest name."""
    context = click.Context(command, show_default=True)
    found = {}
    for option in command.params:
        record = option.get_help_record(context) if isinstance(option, click.Option) else None
        if record:
            name = max(option.opts, key=len)
            found[name] = f"- `{record[0]}`: {' '.join(record[1].split())}"
    return found


def describe_command(name: str, command: click.Command) -> str:
    """Return the usage and the text of a command; its examples are a block."""
    context = click.Context(command, info_name=f"mocap-calib {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    text = inspect.cleandoc(command.help or "").replace("\b\n", "")
    text, *heading = re.split(r"^(Example.*:)\n", text, maxsplit=1, flags=re.MULTILINE)
    parts = [f"`mocap-calib {name} {usage}`", text.strip()]
    if heading:
        block, _, rest = heading[1].partition("\n\n")
        parts += [heading[0], f"```text\n{inspect.cleandoc(block)}\n```", rest.strip()]
    return "\n\n".join(part for part in parts if part)


if __name__ == "__main__":
    PAGE.write_text(make_page(), encoding="utf-8", newline="\n")
