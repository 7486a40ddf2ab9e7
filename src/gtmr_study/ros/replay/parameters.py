# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The controller's parameters as a bag tells them, from moment to moment."""

from collections.abc import Mapping
from typing import Any

from gtmr_model import ConfigError, Vehicle, YamlModel
from gtmr_monitor.bag.recording import Recording
from gtmr_msgs_py.wire import stamps
from gtmr_nmpc import MODES, ControllerConfig, Mode


class RecordedParameters:
    """The controller's problem and mode as a recorded flight goes on.

    A mode, problem or vehicle that is given is taken throughout, whatever is recorded.

    Raises ConfigError if the recorded parameters make no configuration, as where the vehicle is a
    file that is gone.
    """

    def __init__(
        self,
        recording: Recording,
        mode: Mode | None = None,
        config: ControllerConfig | None = None,
        vehicle: Vehicle | None = None,
    ) -> None:
        self.source = f"{recording.path}: parameters of {recording.node}"
        """What to name in errors."""
        self._mode, self._config, self._vehicle = mode, config, vehicle
        self._changes = recording.controller_changes
        self._values: dict[str, Any] = {}
        for change in self._changes:
            # What is first heard of late was so from the start.
            self._values = change.values | self._values
        self._build()
        self.guessed = self._guessed()
        """Parameters that neither bag nor caller tells, and the defaults taken for them."""

    @property
    def max_stamp_difference_ns(self) -> int:
        """How far apart the node takes odometry and rotor speeds together [ns]."""
        return stamps.nanoseconds(float(self._values.get("max_stamp_difference_s", 0.0)))

    def advance(self, time_ns: int) -> bool:
        """Take over what was changed before a Unix time [ns]; say whether anything was.

        Raises ConfigError if the parameters make no configuration any more.
        """
        values = dict(self._values)
        while self._changes and self._changes[0].sent_ns < time_ns:
            values |= self._changes.pop(0).values
        if values == self._values:
            return False
        self._values = values
        self._build()
        return True

    def _build(self) -> None:
        config = self._config or ControllerConfig.parse(
            _nested(self._values, ControllerConfig), self.source
        )
        if self._vehicle is not None:
            config = config.model_copy(update={"vehicle": self._vehicle})
        self.config = config
        """The problem now; parameters that are not recorded have their defaults."""
        mode = self._mode or self._values.get("mode", "robust")
        if mode not in MODES:
            raise ConfigError(f"{self.source}: mode = {mode!r}: allowed is {' or '.join(MODES)}")
        self.mode: Mode = mode
        """The controller's mode now."""

    def _guessed(self) -> dict[str, Any]:
        taken: dict[str, Any] = {} if self._mode else {"mode": self.mode}
        if self._config is None:
            taken |= _flat(self.config.model_dump(mode="json", exclude={"vehicle"}))
            taken |= {} if self._vehicle else {"vehicle": self.config.vehicle.name}
        return {name: value for name, value in taken.items() if not self._is_told(name)}

    def _is_told(self, name: str) -> bool:
        """Whether the bag has a parameter, a part of it, or what it is a part of by name."""
        return any(
            f"{told}.".startswith(f"{name}.") or f"{name}.".startswith(f"{told}.")
            for told in self._values
        )


def _flat(data: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Name the fields of a model with dots, as the node does."""
    flat: dict[str, Any] = {}
    for field, value in data.items():
        name = above + field
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat


def _nested(values: Mapping[str, Any], model: type[YamlModel], above: str = "") -> dict[str, Any]:
    """Pick a model's fields from dotted names; the node has more parameters than the model."""
    data: dict[str, Any] = {}
    for field, info in model.model_fields.items():
        name, kind = above + field, info.annotation
        if name in values:
            data[field] = values[name]
        elif isinstance(kind, type) and issubclass(kind, YamlModel):
            nested = _nested(values, kind, f"{name}.")
            data |= {field: nested} if nested else {}
    return data
