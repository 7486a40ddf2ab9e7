# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A controller of one's own: a class in a Python file, which only a command line can name."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from gtmr_model import YamlModel
from gtmr_nmpc import MODES, ControllerConfig
from gtmr_sim import StepController
from gtmr_study.result_files import InputError, one_line


class ControllerFingerprint(YamlModel):
    """Which own controller it was, for a study's description; it runs nothing."""

    name: str
    """Of the class."""
    sha256: str
    """Of the file, hexadecimal."""


@dataclass(frozen=True)
class OwnController:
    """The text of a file and the name of a class in it; goes to workers that lack the file.

    The file imports what is installed, no neighbours.
    """

    path: str
    """Where it was read, for messages and tracebacks."""
    name: str
    """Of the class; also the ``mode`` of its flights in results."""
    source: str
    """The file's text."""

    @classmethod
    def named(cls, option: str, value: str) -> OwnController | None:
        """Read ``file.py:Class``; None if the value of an option names no Python file.

        InputError if it does, but the file cannot be read.
        """
        path, _, name = value.rpartition(":")
        if not path.endswith(".py"):
            if value.endswith(".py"):
                raise InputError(f"{option} = {value}: expected {value}:Class")
            return None
        if name in MODES or not name.isidentifier():
            raise InputError(f"{option} = {value}: {name!r} is no name of a class to fly")
        try:
            source = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{option} = {value}: {path} cannot be read: {error}") from None
        return cls(path, name, source)

    @property
    def fingerprint(self) -> ControllerFingerprint:
        """Its name and what its text was."""
        digest = hashlib.sha256(self.source.encode()).hexdigest()
        return ControllerFingerprint(name=self.name, sha256=digest)

    def make(self, config: ControllerConfig) -> StepController:
        """Run the file and make one controller, for one flight: nothing is shared with others.

        InputError if the file does not run, has no such class, or its constructor raises.
        """
        module = ModuleType(f"own_controller_{self.fingerprint.sha256[:16]}")
        module.__file__ = self.path
        # Dataclasses and pickle look a class's module up here.
        sys.modules[module.__name__] = module
        try:
            exec(compile(self.source, self.path, "exec"), module.__dict__)
            if not hasattr(module, self.name):
                classes = [
                    name
                    for name, value in vars(module).items()
                    if isinstance(value, type) and value.__module__ == module.__name__
                ]
                known = ", ".join(classes) or "none"
                raise InputError(f"{self.path} has no class {self.name}: there is {known}")
            controller: StepController = getattr(module, self.name)(config)
        except InputError:
            raise
        except Exception as error:
            reason = one_line(error)
            raise InputError(f"{self.path}:{self.name} cannot be made: {reason}") from None
        if not callable(getattr(controller, "step", None)):
            raise InputError(f"{self.path}:{self.name} has no step(t, x)")
        return controller
