# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The parameters of a node, kept together as the configuration that they make up."""

from __future__ import annotations

import copy
from array import array
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from pydantic import Field
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.parameter import Parameter

from gtmr_model import ConfigError, YamlModel
from gtmr_model.yaml_file import read_yaml
from gtmr_model.yaml_model import from_folder, presets_of
from gtmr_msgs_py.contract import BASE_LINK, MAP, Frames
from gtmr_msgs_py.node.declarations import Declaration, declarations

if TYPE_CHECKING:
    from rclpy.node import Node

M = TypeVar("M", bound=YamlModel)


class FrameParameters(YamlModel):
    """The parameters that name the frames; a message of others is dropped."""

    world_frame: str = Field(MAP, min_length=1)
    """Name of the world frame, ENU."""
    body_frame: str = Field(BASE_LINK, min_length=1)
    """Name of the vehicle's frame, FLU; it differs where several vehicles share a world frame."""

    @property
    def frames(self) -> Frames:
        """Both names."""
        return Frames(self.world_frame, self.body_frame)


class ModelParameters(Generic[M]):
    """The parameters of a node, held together by the configuration that they make up.

    Its defaults are theirs; for ``presets`` and ``dynamic`` see `declarations`, all parameters
    that are not dynamic are read-only. ``settle`` maps the configuration at start to the one to
    use, for values that are drawn or computed once; what it changes is set before parameters
    become read-only. ``base`` is the parameter, if there is one, that names a preset or a YAML
    file of the whole configuration, whose values are the others' defaults. ``on_change`` gets the
    new configuration after a dynamic parameter was set.

    Raises ConfigError if a value from the command line or a parameter file has a wrong type or is
    refused.
    """

    def __init__(
        self,
        node: Node,
        model_type: type[M],
        presets: Mapping[str, str] | None = None,
        dynamic: Collection[str] = (),
        settle: Callable[[M], M] | None = None,
        on_change: Callable[[M], None] | None = None,
        base: str = "",
    ) -> None:
        self._node = node
        self._model_type = model_type
        self._presets = dict(presets or {})
        self._loaded: dict[tuple[str, str], YamlModel] = {}
        self._on_change = on_change
        self._declarations = {
            declaration.name: declaration
            for declaration in declarations(self._defaults(base), self._presets, dynamic)
        }
        self._declare(self._declarations)
        self.value: M = self._build({})
        """The configuration in force."""
        if settle is not None:
            self._settle(settle(self.value))
        self._fix()
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def _defaults(self, base: str) -> M:
        """Read the defaults, and take the presets that they name."""
        usual = self._model_type()
        if not base:
            return usual
        (told,) = [d for d in declarations(usual, self._presets) if d.name == base]
        self._declare({base: told})
        chosen = str(self._node.get_parameter(base).value)
        loaded = self._model_type.load(base, chosen)
        known = presets_of(base)
        written = read_yaml(known.get(chosen, Path(chosen)))
        for name in self._presets:
            if name in loaded.model_fields_set:
                # If the file does not name it, it is the one that was read there.
                named = written.get(name)
                if isinstance(named, str) and chosen not in known:
                    named = from_folder(Path(chosen).absolute().parent, named)
                self._presets[name] = named if isinstance(named, str) else chosen
                self._loaded[name, self._presets[name]] = getattr(loaded, name)
        return loaded.model_copy(update={base: chosen})

    def _declare(self, declarations: Mapping[str, Declaration]) -> None:
        for name, declaration in declarations.items():
            if self._node.has_parameter(name):
                continue
            # Read-only comes last: until then values may still be settled.
            descriptor = copy.deepcopy(declaration.descriptor)
            descriptor.read_only = False
            try:
                self._node.declare_parameter(name, declaration.value, descriptor)
            except InvalidParameterTypeException:
                expected = Parameter.Type.from_parameter_value(declaration.value).name.lower()
                raise ConfigError(
                    f"{self._node.get_name()}: {name} has a value of the wrong type: expected "
                    f"{expected.replace('_', ' ')}, as {declaration.value!r}"
                ) from None
            except InvalidParameterValueException as error:
                reason = str(error).rpartition("Reason: ")[2].removesuffix(f": {name}")
                raise ConfigError(f"{self._node.get_name()}: {reason}") from None
            except ParameterException as error:
                raise ConfigError(f"{self._node.get_name()}: {name}: {error}") from None

    def _settle(self, value: M) -> None:
        self.value = value
        settled = [
            Parameter(declaration.name, value=declaration.value)
            for declaration in declarations(value, self._presets)
            if declaration.name not in self._presets
        ]
        changed = [
            parameter
            for parameter in settled
            if parameter.value != _plain(self._node.get_parameter(parameter.name).value)
        ]
        self._node.set_parameters(changed)

    def _fix(self) -> None:
        for name, declaration in self._declarations.items():
            descriptor = copy.deepcopy(self._node.describe_parameter(name))
            descriptor.read_only = declaration.descriptor.read_only
            self._node.set_descriptor(name, descriptor)

    def _build(self, proposed: Mapping[str, Any]) -> M:
        data: dict[str, Any] = {}
        for name, declaration in self._declarations.items():
            value = proposed.get(name, self._node.get_parameter(name).value)
            if name in self._presets:
                value = self._preset(name, value)
            branch = data
            for part in declaration.path[:-1]:
                branch = branch.setdefault(part, {})
            branch[declaration.path[-1]] = _plain(value)
        return self._model_type.parse(data, self._node.get_name())

    def _preset(self, name: str, value: str) -> YamlModel:
        """Read a preset once: a file that is edited in flight must not stop other changes."""
        if (name, value) not in self._loaded:
            annotation = cast("type[YamlModel]", self._model_type.model_fields[name].annotation)
            self._loaded[name, value] = annotation.load(name, value)
        return self._loaded[name, value]

    def _ours(self, parameters: Collection[Parameter]) -> dict[str, Any]:
        return {p.name: p.value for p in parameters if p.name in self._declarations}

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        proposed = self._ours(parameters)
        if proposed:
            try:
                self._build(proposed)
            except ConfigError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        if self._ours(parameters):
            self.value = self._build({})
            if self._on_change is not None:
                self._on_change(self.value)


def _plain(value: Any) -> Any:
    """Turn the arrays that rclpy keeps into lists."""
    return list(value) if isinstance(value, array) else value
