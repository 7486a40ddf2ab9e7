# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters that were given to a node but that it does not have: rclpy ignores them silently."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from gtmr_model import ConfigError

if TYPE_CHECKING:
    from rclpy.node import Node

Section = tuple[str, set[str]]
"""Which nodes a part of a parameter file is for, and the names in it."""


def refuse_unknown_names(node: Node, args: Sequence[str]) -> None:
    """Refuse parameters that do not exist, after a node has declared those that do.

    A section of a file for any node, such as ``/**``, may name parameters of another node of the
    suite; what is given to this node alone may not. The ConfigError names the closest.
    """
    # rclpy has no public name for what the command line and the parameter files say.
    unknown = [name for name in node._parameter_overrides if not node.has_parameter(name)]
    if not unknown:
        return
    every_node = (files("gtmr_model") / "config" / "parameters.yaml").read_text(encoding="utf-8")
    shared = _shared_names(args)
    suite = {section.rpartition("/")[2]: names for section, names in _sections(every_node)}
    own = set(node.list_parameters([], 0).names)
    for name in sorted(unknown):
        others = sorted(other for other, names in suite.items() if name in names)
        if others and name in shared:
            continue
        known = own.union(*suite.values()) if name in shared else own
        (closest,) = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.0)
        hint = f"it is one of {' and '.join(others)}" if others else f"the closest is {closest}"
        raise ConfigError(f"{node.get_name()}: there is no parameter {name}: {hint}")


def _shared_names(args: Sequence[str]) -> set[str]:
    """Names in the sections of parameter files that are for any node, and nowhere else."""
    shared: set[str] = set()
    alone: set[str] = set()
    for option, value in pairwise(args):
        if option == "--params-file":
            text = Path(value).read_text(encoding="utf-8", errors="replace")
            try:
                sections = list(_sections(text))
            except (yaml.YAMLError, RecursionError) as error:
                # rcl has read it before, but with another parser.
                raise ConfigError(f"{value}: not a YAML file: {error}") from None
            for section, names in sections:
                for_any = "*" in section.rpartition("/")[2]
                (shared if for_any else alone).update(names)
        elif option in ("-p", "--param"):
            alone.add(value.partition(":=")[0].rpartition(":")[2])
    return shared - alone


def _sections(text: str) -> Iterator[Section]:
    # Names alone are read: launch_ros tags values in ways that only its own Python knows.
    yield from _sections_of(yaml.compose(text, yaml.SafeLoader), "")


def _sections_of(tree: yaml.Node | None, above: str) -> Iterator[Section]:
    for name, value in _entries(tree):
        if name == "ros__parameters":
            yield above, set(_flat(value, ""))
        else:
            yield from _sections_of(value, f"{above}/{name}".replace("//", "/"))


def _flat(tree: yaml.Node, above: str) -> Iterator[str]:
    for name, value in _entries(tree):
        if isinstance(value, yaml.MappingNode):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"


def _entries(tree: yaml.Node | None) -> list[tuple[str, yaml.Node]]:
    if not isinstance(tree, yaml.MappingNode):
        return []
    return [(str(key.value), value) for key, value in tree.value]
