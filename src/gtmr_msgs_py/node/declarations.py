# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Declares a configuration model as ROS parameters: one parameter for each field.

Nested models become dotted names. Description, unit, range and choices come from the field; what
ROS cannot express is checked by building the model from the proposed values.

This is chosen over generate_parameter_library because the models already exist: they check the
same configurations where there is no ROS, from YAML files and from Python, in the same words. A
second declaration of every parameter, and a package that wheels do not bring, would gain nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, cast, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from gtmr_model import YamlModel

INT64_MAX = 2**63 - 1
"""Largest value of an integer parameter."""


@dataclass(frozen=True)
class Bounds:
    """The range that a field's constraints allow."""

    low: float | None = None
    """Smallest value, or none."""
    high: float | None = None
    """Largest value, or none."""
    text: str = ""
    """The same in words; only this tells that a bound itself is not allowed."""

    @classmethod
    def of(cls, constraints: Collection[Any]) -> Bounds:
        """Collect the bounds among the constraints that pydantic keeps of a field."""
        low: float | None = None
        high: float | None = None
        words = []
        for constraint in constraints:
            match constraint:
                case annotated_types.Ge(ge=bound):
                    low, word = float(cast(float, bound)), "at least"
                case annotated_types.Gt(gt=bound):
                    low, word = float(cast(float, bound)), "greater than"
                case annotated_types.Le(le=bound):
                    high, word = float(cast(float, bound)), "at most"
                case annotated_types.Lt(lt=bound):
                    high, word = float(cast(float, bound)), "less than"
                case _:
                    continue
            words.append(f"{word} {bound:g}")
        return cls(low, high, ", ".join(words))


@dataclass(frozen=True)
class Declaration:
    """One ROS parameter of a configuration."""

    path: tuple[str, ...]
    """Field names from the model down."""
    value: Any
    """Default, of a type that ROS knows."""
    descriptor: ParameterDescriptor = field(compare=False)
    """What ``ros2 param describe`` shows."""

    @property
    def name(self) -> str:
        """The parameter's name, dotted."""
        return ".".join(self.path)


def declarations(
    model: YamlModel, presets: Mapping[str, str] | None = None, dynamic: Collection[str] = ()
) -> list[Declaration]:
    """List the parameters that a configuration becomes; its values are the defaults.

    Presets are top-level fields that are one string, a preset's name or the path of a YAML file,
    with the default name. Dynamic parameters, by name, may change while the node runs; the name of
    a nested model stands for all that is in it.
    """
    return list(_declarations(model, presets or {}, frozenset(dynamic), ()))


def _declarations(
    model: YamlModel, presets: Mapping[str, str], dynamic: frozenset[str], above: tuple[str, ...]
) -> Iterator[Declaration]:
    for name, info in type(model).model_fields.items():
        path = (*above, name)
        value = getattr(model, name)
        read_only = not any(".".join(path[:n]) in dynamic for n in range(1, len(path) + 1))
        if not above and name in presets:
            descriptor = ParameterDescriptor(
                description=_sentence(info),
                additional_constraints="name of a preset, or path of a .yaml file",
                read_only=read_only,
            )
            yield Declaration(path, presets[name], descriptor)
        elif isinstance(value, dict):
            # ROS parameters have no mappings: only a file or Python sets these.
            continue
        elif isinstance(value, YamlModel):
            yield from _declarations(value, presets, dynamic, path)
        else:
            default = _ros_value(value, info.annotation)
            yield Declaration(path, default, _descriptor(info, read_only))


def _descriptor(info: FieldInfo, read_only: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=_sentence(info), read_only=read_only)
    annotation, bounds = info.annotation, Bounds.of(info.metadata)
    choices = get_args(annotation) if get_origin(annotation) is Literal else ()
    for constraint in info.metadata:
        # As a registry of what can be named, which belongs to a layer above.
        if hasattr(constraint, "names"):
            choices = constraint.names()
    if choices:
        descriptor.additional_constraints = "one of: " + ", ".join(choices)
        return descriptor
    if get_origin(annotation) is tuple:
        descriptor.additional_constraints = _tuple_constraints(info)
        return descriptor
    descriptor.additional_constraints = bounds.text
    if bounds.low is None and bounds.high is None:
        return descriptor
    # A ROS range includes its ends, and a missing end is infinity; the model refuses the rest.
    if annotation is int:
        descriptor.integer_range = [
            IntegerRange(
                from_value=-INT64_MAX if bounds.low is None else int(bounds.low),
                to_value=INT64_MAX if bounds.high is None else int(bounds.high),
                step=0,
            )
        ]
    elif annotation is float:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-math.inf if bounds.low is None else bounds.low,
                to_value=math.inf if bounds.high is None else bounds.high,
                step=0.0,
            )
        ]
    return descriptor


def _tuple_constraints(info: FieldInfo) -> str:
    items = get_args(info.annotation)
    if items[0] is str:
        return "texts"
    if items[-1] is Ellipsis:
        low = next(c.min_length for c in info.metadata if hasattr(c, "min_length"))
        bounded = any(hasattr(c, "max_length") for c in info.metadata)
        size = f"{low}" if bounded else f"at least {low}"
    else:
        size = f"{len(items)}"
    constraints: list[Any] = []
    if get_origin(items[0]) is Annotated:
        for extra in items[0].__metadata__:
            constraints += extra.metadata if isinstance(extra, FieldInfo) else [extra]
    each = Bounds.of(constraints).text
    return f"{size} numbers, each {each}" if each else f"{size} numbers"


def _sentence(info: FieldInfo) -> str:
    return " ".join((info.description or "").split())


def _ros_value(value: Any, annotation: Any) -> Any:
    """Convert by the annotation, as a default of 0 for a float would become an integer."""
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) is tuple:
        item_type = get_args(annotation)[0]
        # An empty list has no type in ROS: a list with an empty text stands for it.
        none = [""] if item_type is str else []
        return [_ros_value(item, item_type) for item in value] or none
    if get_origin(annotation) is Literal:
        return str(value)
    return annotation(value)
