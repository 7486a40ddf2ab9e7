# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The preset field without a part that no parameter turns off."""

from typing import Any

from gtmr_nmpc import Controller, ControllerConfig


class NoPrediction:
    """Takes a late state for the present one."""

    def __init__(self, config: ControllerConfig) -> None:
        told = ControllerConfig.load("controller", "field")
        self.config = told.model_copy(update={"helix": config.helix})
        self._controller = Controller(self.config, "offset_free")

    def reset(self) -> None:
        """Begin another flight."""
        self._controller.reset()

    def step(self, t: float, x: Any) -> Any:
        """Plan from the stamp on."""
        return self._controller.step(t, x)
