# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Reads YAML from untrusted authors: plain data within bounds, or an error in one line.

Only what configurations are made of is read: text, numbers, yes and no, lists and mappings. A tag
that stands for anything else, and so for code, is refused.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import yaml

MAX_BYTES = 256 * 1024
"""Largest file; the longest configuration that comes with the suite has 4 KiB."""
MAX_DEPTH = 20
"""How deeply lists and mappings may be nested."""
MAX_VALUES = 10_000
"""How many values there may be, each counted as often as aliases repeat it."""
PLAIN_TAGS = ("bool", "float", "int", "map", "merge", "null", "seq", "str")
"""Types that are allowed, by the names of YAML 1.1."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message is one line naming field and value."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


def printable(text: str) -> str:
    """Write characters that cannot be printed, line ends too, as Python's escapes."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file as plain data.

    Raises ConfigError if it cannot be read, is no file of at most `MAX_BYTES`, is no UTF-8 or no
    YAML, or is beyond any other bound.
    """
    try:
        # Opened without blocking: a pipe without a writer would block.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ConfigError(f"{path}: is no file")
            with open(descriptor, "rb", closefd=False) as file:
                content = file.read(MAX_BYTES + 1)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if len(content) > MAX_BYTES:
        raise ConfigError(f"{path}: has more than the {MAX_BYTES // 1024} KiB that are allowed")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a YAML file: {error}") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Any:
    """Read one YAML document as plain data; the source is what an error calls it.

    Raises ConfigError if it is no YAML, has two keys of the same name in a mapping, or is beyond
    a bound.
    """
    try:
        loader = _PlainLoader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, ArithmeticError) as error:
        # Beside its own errors, PyYAML lets those of int() and the like pass.
        reason = " ".join(str(error).split())
        raise ConfigError(f"{source}: not a YAML file: {reason}") from None


class _PlainLoader(yaml.SafeLoader):
    """Constructs plain data only, and gives up at the first bound that is passed."""

    yaml_constructors = {  # noqa: RUF012 -- PyYAML's own way to say it
        tag: make
        for tag, make in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.rpartition(":")[2] in PLAIN_TAGS
    }
    # A date is text here.
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, regexp) for tag, regexp in known if tag.rpartition(":")[2] in PLAIN_TAGS]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._values = 0
        # Of every node that is complete: values and levels in it, aliases followed.
        self._sizes: dict[yaml.Node, int] = {}
        self._heights: dict[yaml.Node, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: int) -> Any:
        """Count while composing; what an alias repeats counts again."""
        mark = self.peek_event().start_mark
        if self.check_event(yaml.AliasEvent):
            node: Any = super().compose_node(parent, index)
            if node not in self._sizes:
                raise _error("an alias within what it stands for", mark)
            self._values += self._sizes[node]
        else:
            before = self._values
            self._values += 1
            self._depth += 1
            # Here as well, since composing it takes a level of Python's own stack.
            self._bound(0, mark)
            node = super().compose_node(parent, index)
            self._depth -= 1
            self._sizes[node] = self._values - before
            below = [self._heights[child] for child in _children(node)]
            self._heights[node] = 1 + max(below, default=0)
        self._bound(self._heights[node], mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Refuse a key that occurs twice: the last would win silently."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    raise _error(f"{key.value!r} is there twice", key.start_mark)
                seen.add((key.tag, key.value))
        return node

    def _bound(self, height: int, mark: yaml.Mark) -> None:
        if self._depth + height > MAX_DEPTH:
            raise _error(f"more than {MAX_DEPTH} levels", mark)
        if self._values > MAX_VALUES:
            raise _error(f"more than {MAX_VALUES} values", mark)


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [each for pair in node.value for each in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def _error(problem: str, mark: yaml.Mark) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
