"""The command line: `framecast COMMAND ...`, each command a function whose arguments are its options.

Only what the command needs is imported: loading everything takes seconds.
"""

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import tyro
from tyro.conf import OmitArgPrefixes

COMMANDS: dict[str, str] = {
    "upsample": "commands.upsample",
    "import": "commands.import_shot",
    "export-clip": "export_clip.command",
    "constants": "constants.command",
    "check": "commands.check_clip",
    "doctor": "doctor.command.command",
    "evaluate": "campaign.command",
    "report": "report.command",
    "bench": "bench.command",
    "labels": "labels.command",
    "render": "render.command.command",
    "train": "train.command",
    "demo": "demo.demo",
}
"""Where the function of each command is, below the package."""


def functions(arguments: Sequence[str]) -> dict[str, Callable[..., Any]]:
    """The command that is asked for, by its name; all of them where none is."""
    found = {}
    for name in [name for name in arguments[:1] if name in COMMANDS] or COMMANDS:
        module, _, function = COMMANDS[name].rpartition(".")
        found[name] = getattr(import_module(f"framecast.{module}"), function)
    return found


def said() -> Callable[..., None]:
    """Shows a warning as one sentence, without the line of code that gave it, and each sentence once."""
    before: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if str(message) not in before:
            print(f"framecast: {message}", file=sys.stderr)
        before.add(str(message))

    return show


def main(arguments: list[str] | None = None) -> int:
    """Run one command.

    0: done; 1: the doctor found something; 2: what was given is wrong, said in a sentence; 130: interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        with warnings.catch_warnings():
            warnings.showwarning = said()
            code = tyro.extras.subcommand_cli_from_dict(
                functions(arguments),
                prog="framecast",
                description="More pixels and more frames than were shaded.",
                args=arguments,
                config=(OmitArgPrefixes,),
            )
    except (ValueError, FileNotFoundError) as error:
        print(f"framecast: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # who read what is printed has gone, as `head` does; the interpreter shall not write more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(
            f"framecast: {where}{error.strerror or error}; free some space or choose another place, then run the same "
            f"command again",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print("framecast: interrupted; run the same command again to go on", file=sys.stderr)
        return 130
    return code if isinstance(code, int) else 0


if __name__ == "__main__":
    sys.exit(main())
