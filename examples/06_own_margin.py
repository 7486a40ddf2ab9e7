# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A margin of your own: one method that says by how much to tighten every stage."""

import numpy as np

from gtmr_model import Helix
from gtmr_nmpc import Controller, ControllerConfig, Margin
from gtmr_nmpc.margins import FixedMargin, PaperMargin
from gtmr_sim import Scenario, fly


class RootSumOfSquares(Margin):
    """Channels of zeta that are independent rarely all go to their worst at once."""

    kind: str = "root-sum-of-squares"  # its name in YAML: margin: {kind: root-sum-of-squares}
    share: float = 1.0

    def tightening(self, iterate):
        """Add the channels of eq. (12) like standard deviations [m], shape (N + 1,)."""
        paper = PaperMargin().tightening(iterate)
        return self.share * np.sqrt((paper.by_channel**2).sum(axis=1)) + paper.gust


def main():
    """Fly the same flight, along a helix that is too close, with three margins."""
    scenario = Scenario(seed=1, helix=Helix(offset_m=0.22)).sampled()
    for margin in (PaperMargin(), FixedMargin(margin_m=0.01), RootSumOfSquares(share=0.8)):
        config = ControllerConfig(helix=scenario.helix, margin=margin)
        log = fly(scenario, Controller(config), 5.0)
        tightened_m = log.alpha_p[-1, -1] + log.alpha_g[-1, -1]
        print(
            f"{margin.kind:>20}: {tightened_m:.3f} m at the last stage, clearance after the start "
            f"at least {log.d_T[40:].min():.3f} m"
        )


if __name__ == "__main__":
    main()
