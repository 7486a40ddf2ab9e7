# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Tune the rivals that have numbers of their own; the same seed finds the same ones again.

python bench/tune_rivals.py [NAME ...] [--worlds paper,field,hard] writes config/rivals/NAME.yaml;
what is in it for other worlds stays.
"""

import argparse
import time
from pathlib import Path

from gtmr_study.result_files import write_whole
from gtmr_study.rivals.catalogue import RIVALS
from gtmr_study.rivals.tuning import (
    EVALUATIONS,
    SEED,
    TRIALS,
    WORLDS,
    Tuned,
    Tuning,
    as_yaml,
    search,
)

FOLDER = Path(__file__).parents[1] / "config" / "rivals"


def main() -> None:
    """Search one rival and world after the other."""
    tuned = {
        rival.make.name: rival.make for rival in RIVALS.values() if isinstance(rival.make, Tuned)
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(tuned)}")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="which, with commas in between")
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help="sets of numbers")
    parser.add_argument("--trials", type=int, default=TRIALS, help="flights of a set")
    arguments = parser.parse_args()
    worlds = arguments.worlds.split(",")
    for kind, given, known in (("NAME", arguments.names, tuned), ("--worlds", worlds, WORLDS)):
        for name in given:
            if name not in known:
                parser.error(f"{kind} = {name}: there is {', '.join(known)}")
    for name in arguments.names or tuned:
        rival, path = tuned[name], FOLDER / f"{name}.yaml"
        there = Tuning.from_yaml(path).worlds if path.exists() else {}
        for world in worlds:
            start = time.perf_counter()

            def tell(tried: int, cost_m: float, what: str = f"{name}, {world}") -> None:
                print(f"\r{what}: {tried} sets, cost {1e3 * cost_m:.1f} mm", end="", flush=True)

            there[world] = search(rival, world, arguments.evaluations, arguments.trials, tell)
            print(f", {time.perf_counter() - start:.0f} s: {there[world].parameters}")
            tuning = Tuning(seed=SEED, worlds={w: there[w] for w in WORLDS if w in there})
            FOLDER.mkdir(exist_ok=True)
            write_whole(path, as_yaml(rival, tuning))


if __name__ == "__main__":
    main()
