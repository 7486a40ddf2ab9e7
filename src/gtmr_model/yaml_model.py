# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Frozen, validated data with a YAML face: the base of every configuration in the suite."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

import casadi as ca
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from typing_extensions import Self

from gtmr_model.yaml_file import ConfigError, read_yaml

MAX_PROBLEMS = 12
"""How many fields that are wrong are named in one line."""
MAX_VALUE_TEXT = 80
"""How much of a wrong value is shown, in characters."""


def describe(error: ValidationError) -> str:
    """Say in one line which fields are wrong, which values they had and what is allowed.

    For example ``mass_kg = -1.0: Input should be greater than 0``.
    """
    problems = []
    # A default that was not made, for want of what is wrong already, is no problem of its own.
    found = [e for e in error.errors() if e["type"] != "default_factory_not_called"]
    for problem in found[:MAX_PROBLEMS]:
        field = ".".join(str(part) for part in problem["loc"])
        reason = problem["msg"].removeprefix("Value error, ")
        # What is read by its name says itself what it is.
        reason = reason.removeprefix(f"{field.rpartition('.')[2]} = {_shown(problem['input'])}: ")
        if problem["type"] == "missing":
            problems.append(f"{field} is missing")
        elif problem["type"] == "extra_forbidden":
            problems.append(f"{field} is not a known field")
        elif not field:
            problems.append(reason)
        else:
            problems.append(f"{field} = {_shown(problem['input'])}: {reason}")
    if len(found) > MAX_PROBLEMS:
        problems.append(f"and {len(found) - MAX_PROBLEMS} more")
    return "; ".join(problems)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MAX_VALUE_TEXT else f"{text[:MAX_VALUE_TEXT]}..."


def presets_of(kind: str) -> dict[str, Path]:
    """List the configurations of a kind that come with the package: their files by name."""
    folder = files("gtmr_model") / "config" / kind
    there = (Path(str(entry)) for entry in folder.iterdir())
    return {file.stem: file for file in sorted(there) if file.suffix == ".yaml"}


FOLDER = "folder"
"""Key of the validation context under which the folder of what is read stands."""


def named(kind: str, load: Callable[[str, str], YamlModel]) -> BeforeValidator:
    """Let a field also be the name of a preset of a kind, or the path of a YAML file.

    A relative path in a YAML file starts at the folder of that file. ``load`` is as
    `YamlModel.load`.
    """

    def by_name(value: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, str):
            return value
        folder = (info.context or {}).get(FOLDER)
        return load(kind, value if folder is None else from_folder(folder, value))

    return BeforeValidator(by_name)


def from_folder(folder: Path, name_or_path: str) -> str:
    """Take the path of a YAML file from a folder on; a preset's name stays as it is."""
    is_path = name_or_path.endswith((".yaml", ".yml"))
    return str(folder / name_or_path) if is_path else name_or_path


class YamlModel(BaseModel):
    """An immutable configuration: unknown fields and values out of range are refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    @classmethod
    def parse(cls, data: Any, source: str, folder: Path | None = None) -> Self:
        """Validate plain data, for example the content of a YAML file.

        Paths of further YAML files in it are relative to the folder, or to where the process runs.
        Raises ConfigError if a field is missing, unknown or out of range.
        """
        try:
            return cls.model_validate(data, context={FOLDER: folder})
        except ValidationError as error:
            raise ConfigError(f"{source}: {describe(error)}") from None

    def symbolic(self) -> tuple[Self, ca.SX]:
        """Put symbols in the place of the numbers: the formulas then give expressions.

        The symbols come with it, in the order of `numbers`.
        """
        fields = type(self).model_fields.items()
        names = [name for name, info in fields if info.annotation is float]
        symbols: dict[str, Any] = {name: ca.SX.sym(name) for name in names}
        rest = {name: getattr(self, name) for name, _ in fields if name not in symbols}
        made: Any = type(self).model_construct(**rest, **symbols)
        return made, ca.vertcat(*symbols.values())

    @property
    def numbers(self) -> list[float]:
        """Values of the fields that are one number each, in the order of the fields."""
        fields = type(self).model_fields.items()
        return [getattr(self, name) for name, info in fields if info.annotation is float]

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read and validate a YAML file; paths of further files in it are relative to its folder.

        Raises ConfigError if it cannot be read as `read_yaml` does, or a field is missing,
        unknown or out of range.
        """
        return cls.parse(read_yaml(path), str(path), Path(path).parent)

    @classmethod
    def preset(cls, kind: str, name: str) -> Self:
        """Read a configuration that comes with the package, as ``paper`` of the kind ``vehicle``.

        The kind is the folder under ``config/``. Raises ConfigError if there is no such preset.
        """
        known = presets_of(kind)
        if name not in known:
            raise ConfigError(f"{kind} = {name!r}: there is {', '.join(known)}, or a YAML file")
        return cls.from_yaml(known[name])

    @classmethod
    def load(cls, kind: str, name_or_path: str) -> Self:
        """Read a preset of a kind by its name, or a YAML file (``.yaml``, ``.yml``) by its path.

        Raises ConfigError if there is no such preset or file, or its content is wrong.
        """
        if name_or_path.endswith((".yaml", ".yml")):
            return cls.from_yaml(name_or_path)
        return cls.preset(kind, name_or_path)


class OneOfKinds(YamlModel):
    """The base of a family of models that are told apart by their name, in the field ``kind``.

    A model that inherits from this is a family, with the name of its default; one that inherits
    from a family is a member, known from then on by the default of its ``kind``.
    """

    kind: str
    """Which of the family."""

    _members: ClassVar[dict[str, type[OneOfKinds]]]

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Make a family, or a member of one."""
        if OneOfKinds in cls.__bases__:
            cls._members = {}
        else:
            cls._members[cls.model_fields["kind"].default] = cls

    @model_validator(mode="wrap")
    @classmethod
    def _choose(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        own_kind = cls.model_fields["kind"].default
        if OneOfKinds not in cls.__bases__:
            made = handler(data)
            if made.kind != own_kind:
                raise ValueError(f"{cls.__name__} is of kind {own_kind!r}")
            return made
        if isinstance(data, str):
            data = {"kind": data}
        if not isinstance(data, Mapping):
            return handler(data)
        kind = data.get("kind", own_kind)
        if kind not in cls._members:
            raise ValueError(f"kind = {kind!r}: there is {', '.join(sorted(cls._members))}")
        member: Any = cls._members[kind]
        chosen: Self = member.model_validate(data)
        return chosen

    @classmethod
    def load(cls, kind: str, name_or_path: str) -> Self:
        """Make a member by its name, all else at its defaults, or read it from a YAML file.

        The file is a path that ends in ``.yaml`` or ``.yml``; the kind is what an error calls it,
        for example ``margin``. Raises ConfigError if there is no such member or file, or its
        content is wrong.
        """
        if name_or_path.endswith((".yaml", ".yml")):
            return cls.from_yaml(name_or_path)
        return cls.parse(name_or_path, kind)
