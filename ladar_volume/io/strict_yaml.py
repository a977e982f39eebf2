"""YAML as parameters need it: plain values under plain keys, of bounded size; what else the
language offers is refused in one line.
"""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from ladar_volume.model.errors import ConfigurationError, short_repr

#: Largest file, characters: the longest of parameters has 30,000.
SIZE = 1_000_000
#: Deepest nesting: document, node, ros__parameters, section, list.
DEPTH = 8
#: What constructors of values raise for a tag that does not fit its value.
_VALUES = (ValueError, OverflowError, RecursionError, KeyError, TypeError, AttributeError)


class _Loader(yaml.SafeLoader):
    """A safe loader that refuses a key given twice, keys that are no text, aliases and deep
    nesting; what looks like a date is text.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        line = self.peek_event().start_mark.line + 1  # type: ignore[no-untyped-call]
        if self.check_event(yaml.AliasEvent):
            raise ConfigurationError(f"line {line}: an alias (*): write the value again")
        if self._depth >= DEPTH:
            raise ConfigurationError(f"line {line}: more than {DEPTH} levels")
        self._depth += 1
        try:
            node: yaml.Node | None = super().compose_node(parent, index)
        finally:
            self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value:
            line = key_node.start_mark.line + 1
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise ConfigurationError(
                    f"line {line}: key {short_repr(key)} is no name", value=key
                )
            if key in seen:
                raise ConfigurationError(
                    f"line {line}: key {short_repr(key)} is given twice", value=key
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


# a date is text
_Loader.yaml_implicit_resolvers = {
    first: [(tag, found) for tag, found in rules if tag != "tag:yaml.org,2002:timestamp"]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def parse_yaml(text: str) -> Any:
    """The document of a YAML text. Raises :class:`ConfigurationError`."""
    if len(text) > SIZE:
        raise ConfigurationError(f"more than {SIZE:,} characters: no parameter file")
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        at = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise ConfigurationError(f"not valid YAML: {at}{error.problem}") from error
    except (yaml.YAMLError, *_VALUES) as error:
        raise ConfigurationError(f"not valid YAML: {error}") from error


def read_yaml(path: Path) -> Any:
    """The document of a file. Raises :class:`ConfigurationError`."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(SIZE + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot be read: {error}") from error
    return parse_yaml(text)
