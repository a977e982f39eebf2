"""What the command line says, as lines a terminal can show: whatever a file or an option holds."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import NoReturn, TypeAlias

from ladar_volume.cli.help.near_misses import hint

#: Where a verb, a mode or a study declares its parser.
Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
#: Most characters of an error, with the program's name.
MESSAGE = 300
#: Characters of its end that a shortened error keeps: there it says what to do.
END = 80
#: A number or coordinates that begin with a minus: no option.
NEGATIVE = re.compile(r"-\.?\d[\d.,eE+-]*$")


def printable(text: str) -> str:
    """Text without line ends and control characters."""
    return " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in text).split())


def one_line(text: str, most: int = MESSAGE) -> str:
    """Text as one line of at most ``most`` characters."""
    line = printable(text)
    return line if len(line) <= most else f"{line[: most - END - 3]} … {line[-END:]}"


def shown_name(name: object) -> str:
    """A name from outside for a rich table or line: its brackets are no markup."""
    from rich.markup import escape

    return escape(one_line(str(name), 120))


class Parser(argparse.ArgumentParser):
    """Refuses a command line in one line, and takes options between file names."""

    _mixing = False

    _negative_number_matcher = property(lambda self: NEGATIVE, lambda self, value: None)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """As argparse, with ``A --json B`` for ``A B --json``."""
        rest = (argparse.PARSER, argparse.REMAINDER)
        if self._mixing or any(a.nargs in rest for a in self._get_positional_actions()):
            return super().parse_known_args(args, namespace)
        self._mixing = True  # the mixed way calls this one
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._mixing = False

    def error(self, message: str) -> NoReturn:
        """Print the error and end with code 2."""
        near = hint(message, self)
        if near.startswith("; did") and message.startswith("argument VERB: invalid choice"):
            message = message.partition(" (choose from")[0]
        self.exit(2, one_line(f"{self.prog}: {message}{near}; see {self.prog} --help") + "\n")
