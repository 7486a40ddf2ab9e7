# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Put what was measured into docs/field.md: `python docs/field.py FOLDER...`.

Each folder is one of a campaign or of an attack (with its ``--json`` as FOLDER.json); its name and
what was flown are taken from it. What is told is kept in docs/field/results.json, from which the
page is made again without folders.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import yaml

PAGE = Path(__file__).with_suffix(".md")
KEPT = PAGE.parent / "field" / "results.json"
WORLDS = ("paper", "field", "hard")
FLIGHTS = ("world", "d_ref", "flown", "violations", "least d_T", "radial RMS", "command")
PARTS = ("what", "violations", "least d_T", "radial RMS", "command")
ATTACKS = ("world", "d_ref", "flights", "violations", "least d_T", "command")


def campaign(folder: Path) -> list[dict[str, Any]]:
    """Read what a campaign says, a row a mode."""
    study = json.loads((folder / "study.json").read_text(encoding="utf-8"))["study"]
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    if any(said["errors"] for said in summary.values()):
        raise SystemExit(f"{folder}: some trials ended in an error, and are not counted")
    return [
        {
            "name": f"{folder.name} {mode}",
            "mode": mode,
            "d_ref_m": study["controller"]["helix"]["offset_m"],
            "plan": study["plan"]["kind"],
            "gust": study["gust"]["kind"],
            "seed": study["seed"],
            "duration_s": study["duration_s"],
            "trials": said["trials"],
            "violations": said["violations_any_time"],
            "min_clearance_m": said["min_clearance_any_time_m"],
            "radial_rms_m": said["radial_rms_settled_m"],
        }
        for mode, said in summary.items()
    ]


def attack(folder: Path) -> dict[str, Any]:
    """Read what an attack says."""
    told = json.loads(folder.with_suffix(".json").read_text(encoding="utf-8"))
    with (folder / "flights.jsonl").open(encoding="utf-8") as flights:
        seed = json.loads(flights.readline())["seed"]
    worst = yaml.safe_load((folder / "worst-01.yaml").read_text(encoding="utf-8"))
    del told["worst"]
    return {
        "name": folder.name,
        "d_ref_m": worst["controller"]["helix"]["offset_m"],
        "seed": seed,
        **told,
    }


def table(titles: tuple[str, ...], rows: list[list[str]]) -> str:
    """Write a table in Markdown."""
    lines = [list(titles), ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def flight_row(told: dict[str, Any]) -> list[str]:
    """Write a row of the first table."""
    world = world_of(told)
    options = f"--world {world} --d-ref {told['d_ref_m']:.2f} --modes {told['mode']}"
    if told["plan"] == "random":
        flown = f"{told['trials']} random, {told['duration_s']:g} s, seed {told['seed']}"
        options += f" --trials {told['trials']} --seed {told['seed']}"
    else:
        flown = f"{told['trials']} vertices, `{told['gust']}`, {told['duration_s']:g} s"
        options += f" --plan vertices --gust {told['gust']} --duration {told['duration_s']:g}"
    command = f"`gtmr campaign {options} --out DIR`"
    return [world, f"{told['d_ref_m']:.2f} m", flown, *figures(told), command]


def figures(told: dict[str, Any]) -> list[str]:
    """Violations, least clearance and RMS."""
    rms_m = told["radial_rms_m"]
    return [
        f"{told['violations']} of {told['trials']}",
        f"{told['min_clearance_m']:.3f} m",
        "lost" if rms_m is None or rms_m > 10.0 else f"{1e3 * rms_m:.1f} mm",
    ]


def main() -> None:
    """Keep what the folders say, and write the page."""
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    for folder in map(Path, sys.argv[1:]):
        if (folder / "summary.json").exists():
            kept |= {row["name"]: row for row in campaign(folder)}
        else:
            kept[folder.name] = attack(folder)
    KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept), encoding="utf-8")


def page(text: str, kept: dict[str, Any]) -> str:
    """Put tables between their markers."""
    attacks = [told for told in kept.values() if "flights" in told]
    parts = [told for told in kept.values() if told["name"].startswith("part-")]
    breaks = [told for told in kept.values() if told["name"].startswith("break-")]
    rest = [t for t in kept.values() if t not in [*attacks, *parts, *breaks]]
    rest.sort(key=place)
    tables = {
        "flights": table(FLIGHTS, [flight_row(told) for told in rest]),
        "parts": table(PARTS, [part_row(told) for told in parts]),
        "breaks": table(PARTS, [break_row(told) for told in breaks]),
        "attacks": table(ATTACKS, [attack_row(told) for told in attacks]),
    }
    for name, rows in tables.items():
        pattern = re.compile(f"<!-- {name} -->\n.*?<!-- end -->", re.DOTALL)
        whole = f"<!-- {name} -->\n\n{rows}\n<!-- end -->"
        text, found = pattern.subn(lambda _, whole=whole: whole, text)
        if found != 1:
            raise SystemExit(f"{PAGE}: {found} places for {name}")
    return text


def world_of(told: dict[str, Any]) -> str:
    """World of a campaign, with which its folder's name begins."""
    return next(world for world in WORLDS if told["name"].startswith(world))


def place(told: dict[str, Any]) -> tuple[Any, ...]:
    """Where a row stands."""
    plan = told["plan"] != "random", told["gust"], told["seed"]
    return WORLDS.index(world_of(told)), -told["d_ref_m"], *plan


BREAKS = {
    "break-lag-04": "motors lag by 40 ms, 20 ms are known",
    "break-lag-06": "motors lag by 60 ms, 20 ms are known",
    "break-wall-2": "a wall of four times the effect (2 N, 20 %)",
}
SAID = {
    "part-full": "the preset `field`, mode",
    "part-no-lead": "no lead for the motors' lag",
    "part-no-noise": "odometry believed to be exact",
    "part-paper-margin": "the paper's margin beside the observer",
    "part-softer": "dearer inputs and accelerations",
    "part-no-observer": "these weights without observer (mode `nominal`)",
    "part-no-prediction": "no prediction: the plan begins at the stamp, and is entered late",
}


def part_row(told: dict[str, Any]) -> list[str]:
    """Write a row of the second table."""
    name, _, mode = told["name"].partition(" ")
    said = SAID[name] + (f" `{mode}`" if name == "part-full" else "")
    file = "" if name == "part-full" else f" --controller docs/field/{name[5:]}.yaml"
    if name == "part-no-prediction":
        file, mode = " --controller docs/field/without.py:NoPrediction", ""
    modes = f" --modes {mode}" if mode else ""
    options = f"--world field --d-ref 0.30{modes}{file} --trials 40 --duration 20 --seed 1"
    return [said, *figures(told), f"`gtmr campaign {options} --out DIR`"]


def break_row(told: dict[str, Any]) -> list[str]:
    """Write a row of the table of what breaks it."""
    name = told["name"].partition(" ")[0]
    options = f"--world docs/field/{name[6:]}.yaml --controller field --d-ref 0.30"
    options += " --modes offset_free --trials 40 --duration 20 --seed 1"
    return [BREAKS[name], *figures(told), f"`gtmr campaign {options} --out DIR`"]


def attack_row(told: dict[str, Any]) -> list[str]:
    """Write a row of the third table."""
    options = f"--mode {told['mode']} --world {told['world']} --d-ref {told['d_ref_m']:.2f}"
    return [
        f"{told['world']}, {told['mode']}",
        f"{told['d_ref_m']:.2f} m",
        f"{told['flights']}, seed {told['seed']}",
        str(told["violations"]),
        f"{told['min_clearance_m']:.4f} m",
        f"`gtmr attack {options} --flights {told['flights']} --seed {told['seed']} --out DIR`",
    ]


if __name__ == "__main__":
    main()
