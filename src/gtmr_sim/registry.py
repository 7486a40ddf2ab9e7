# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Gusts and vehicle effects by name: your own, and those that come with the suite."""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from gtmr_model import ConfigError

T = TypeVar("T", bound=Callable[..., Any])


class Registry(Generic[T]):
    """Functions by name: registered in this process, or brought by an installed package.

    A configuration can only name what is there; it never names a file. Worker processes and nodes
    know what is installed, in the group of entry points, not what a script has registered in its
    own process.
    """

    def __init__(self, group: str) -> None:
        self.group = group
        self._registered: dict[str, T] = {}

    def register(self, name: str) -> Callable[[T], T]:
        """Make a decorator that registers a function under a name.

        Raises ValueError if another function has the name; the same one may come again, as from a
        notebook.
        """

        def decorate(function: T) -> T:
            before = self._registered.get(name)
            if before is not None and _place(before) != _place(function):
                raise ValueError(f"{self.group}: {name!r} is registered already")
            self._registered[name] = function
            return function

        return decorate

    def names(self) -> tuple[str, ...]:
        """List what can be named: what is registered, then what is installed."""
        installed = sorted(entry_points(group=self.group).names)
        return tuple(dict.fromkeys((*self._registered, *installed)))

    def __getitem__(self, name: str) -> T:
        """Give the function of a name, loading it where an installed package brings it.

        Raises ConfigError if there is none; lists those there are.
        """
        if name not in self._registered:
            found = list(entry_points(group=self.group, name=name))
            if not found:
                there = ", ".join(self.names()) or "nothing yet"
                raise ConfigError(f"allowed is what is registered or installed: {there}")
            self._registered[name] = found[0].load()
        return self._registered[name]

    def require(self, name: str) -> str:
        """Return a name that is there; raises as looking it up does."""
        _ = self[name]
        return name


def _place(function: Callable[..., Any]) -> tuple[object, object]:
    return getattr(function, "__module__", None), getattr(function, "__qualname__", None)


GUSTS: Registry[Callable[..., Any]] = Registry("gtmr.gusts")
"""Kinds of gust: see `gtmr_sim.gust.make_gust` for what such a function takes and gives."""
EFFECTS: Registry[Callable[..., Any]] = Registry("gtmr.effects")
"""Forces and torques on the true vehicle beyond eq. (3): see `gtmr_sim.plant.Effect`."""
