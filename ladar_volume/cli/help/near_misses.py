"""The nearest option or verb to one that there is not."""

from __future__ import annotations

import argparse
import difflib
import re

#: What argparse says, and the words in it that nobody knows.
_UNKNOWN = re.compile(r"unrecognized arguments: (.*)")
_CHOICE = re.compile(r"argument VERB: invalid choice: '([^']*)'")


def hint(message: str, parser: argparse.ArgumentParser) -> str:
    """ "; did you mean …?" for a refusal of argparse, or nothing."""
    choice, unknown = _CHOICE.match(message), _UNKNOWN.match(message)
    if choice:
        return _nearest(choice[1], list(verbs_of(parser)))
    words = unknown[1].split() if unknown else []
    option = next((w.partition("=")[0] for w in words if w.startswith("--")), None)
    return "" if option is None else _nearest(option, _options(parser))


def _nearest(word: str, known: list[str]) -> str:
    near = difflib.get_close_matches(word, known, 1)
    return f"; did you mean {near[0]}?" if near else ""


def verbs_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The verbs that stand right behind a parser's own options, by name."""
    out: dict[str, argparse.ArgumentParser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            out |= action.choices
    return out


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """Long options of the parser and of those verbs that were declared with theirs."""
    out = [o for a in parser._actions for o in a.option_strings if o.startswith("--")]
    for each in verbs_of(parser).values():
        out += _options(each)
    return out
