# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The command ``gtmr attack``."""

from functools import partial
from pathlib import Path
from typing import Annotated

from gtmr_nmpc import MODES, ControllerConfig
from gtmr_sim import World
from gtmr_study.campaign.study import at_distance, controller_for
from gtmr_study.cli.campaigns.campaign import WorkersOption, reported_progress
from gtmr_study.cli.terminal import (
    ControllerOption,
    DRefOption,
    JsonOption,
    WorldOption,
    console,
    option,
    require_choice,
    require_seed,
)
from gtmr_study.result_files import InputError, require_folder, require_folder_of, write_json

MAX_ATTACK_SEED = 2**32 - 1


def attack_command(
    out: Annotated[Path, option("DIR", "Folder of a search: new, empty, or to go on with.")],
    mode: Annotated[
        str, option("|".join(MODES), "Which mode to attack.", "offset_free")
    ] = "offset_free",
    world: WorldOption = None,
    d_ref: DRefOption = None,
    flights: Annotated[int, option("N", "Flights in all, of 8 s each.", "1000", min=1)] = 1000,
    seed: Annotated[int, option("K", "Seed of the search.", "0")] = 0,
    controller: ControllerOption = None,
    workers: WorkersOption = None,
    json: JsonOption = None,
) -> None:
    """Search mismatch, gusts, delay and start for the flight closest to the tower."""
    require_folder("--out", out)
    require_folder_of("--json", json)
    require_choice("--mode", mode, MODES)
    require_seed(seed, MAX_ATTACK_SEED)
    try:
        from gtmr_study.attack.search import attack
        from gtmr_study.attack.space import Target
    except ModuleNotFoundError as error:
        raise InputError(f"the search needs {error.name}: pip install {error.name}") from None
    met = World.load("world", world or "paper")
    config = ControllerConfig.load("controller", controller or controller_for(met))
    config = at_distance(config, d_ref)
    target = Target.parse({"mode": mode, "controller": config, "world": met}, "attack")
    with reported_progress() as show:
        show("flights", 0, flights)
        result = attack(target, flights, seed, out, workers, partial(show, "flights"))
    result = {"mode": mode, "world": world or "paper", **result}
    console.print(
        f"{result['violations']} of {result['flights']} flights violate the clearance; the least "
        f"is {result['min_clearance_m']:.4f} m.\n"
        f"The worst again:  gtmr fly --scenario {result['worst'][0]['scenario']}",
        soft_wrap=True,
    )
    write_json(json, result)
