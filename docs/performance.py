# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.
"""Put what was measured into docs/performance.md and README: `python docs/performance.py FILE...`.

Each file is what ``gtmr bench --json FILE`` or ``python bench/c_step --json FILE`` wrote. They are
kept in docs/performance/results.json, from which the pages are made again without files.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_suffix(".md")
README = PAGE.parents[1] / "README.md"
KEPT = PAGE.parent / "performance" / "results.json"
FLIGHTS = {
    "calm": "calm",
    "at the limit": "gusts at full bound towards the tower",
    "recovery": "starts too close, too fast, rotors far apart",
}
"""What the situations of the measurements are."""
CONTROLLERS = {
    "nominal": "nominal",
    "frozen": "robust, frozen margins",
    "gradient": "robust, margins with gradient",
    "offset_free": "offset_free",
}
COUNTS = ("steps", "qp_steps", "rival_steps")
"""Options of the command that say how many steps a situation has."""
KINDS = {
    "nominal": "nominal",
    "robust": "robust, frozen margins",
    "gradient": "robust, margins with gradient",
}
QP_SOLVERS = ("DAQP", "PIQP")
SOLVERS = {
    "sqpmethod + qpOASES": "CasADi sqpmethod + qpOASES, states eliminated, one iteration",
    "IPOPT": "CasADi IPOPT, warm-started, to 1e-6",
    "do-mpc": "do-mpc (IPOPT)",
}


def keep(kept: dict[str, Any], file: Path) -> dict[str, Any]:
    """Take in what a file says, under the name of its command."""
    told = json.loads(file.read_text(encoding="utf-8"))
    name = next((key for key in ("c_step", "controller") if key in told), None)
    if name is None:
        raise SystemExit(f"{file}: neither of gtmr bench nor of bench/c_step")
    if name == "c_step":
        return kept | {"c_step": told}
    timed = {
        solver
        for flights in (told["rivals"], *told["qp"].values())
        for by in flights.values()
        for solver in by
    }
    missing = sorted({*QP_SOLVERS, *SOLVERS} - timed)
    if missing:
        raise SystemExit(f"{file}: has no times of {', '.join(missing)}, see gtmr bench --help")
    return kept | {"bench": told}


def table(titles: list[str], rows: list[list[str]]) -> str:
    """Write a table in Markdown."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def said(figures: Any, form: str) -> str:
    """Write several figures in one cell."""
    return ", ".join(format(figure, form) for figure in figures)


def source(bench: dict[str, Any]) -> str:
    """Name the command and the machine that the figures are from."""
    counts = (f"--{name.replace('_', '-')} {bench[name]}" for name in COUNTS)
    return f"`gtmr bench {' '.join(counts)}`, {bench['machine']}"


def steps(bench: dict[str, Any]) -> str:
    """Median and 99.9th percentile of a step [ms], by flight and controller."""
    rows = [
        [FLIGHTS[flight]]
        + [said((by[name]["step"][q] for q in ("median", "p99.9")), ".3f") for name in CONTROLLERS]
        for flight, by in bench["controller"].items()
    ]
    head = f"{source(bench)}; median, 99.9th percentile [ms]:"
    return f"{head}\n\n{table(['flight', *CONTROLLERS.values()], rows)}"


def from_python(bench: dict[str, Any]) -> str:
    """Medians of the step from Python and in C [us], and their ratio, by flight and controller."""
    if "in_c" not in bench:
        return "Not measured yet: `gtmr bench` does."
    rows = [
        [FLIGHTS[flight]]
        + [
            said((1e3 * figures[way]["median"] for way in ("python", "c")), ".1f")
            + f", {figures['ratio']['median']:.2f}"
            for figures in (by[name] for name in CONTROLLERS)
        ]
        for flight, by in bench["in_c"].items()
    ]
    head = f"{source(bench)}; medians from Python and in C [µs], ratio:"
    return f"{head}\n\n{table(['flight', *CONTROLLERS.values()], rows)}"


def c_steps(told: dict[str, Any]) -> str:
    """Percentiles of the C step [us], then and now, and their ratios."""
    rows = []
    for flight, by in told["c_step"].items():
        for kind, figures in by.items():
            then, now = figures["then_us"], figures["now_us"]
            ratios = [b / a for a, b in zip(then, now, strict=True)]
            cells = said(then, ".1f"), said(now, ".1f"), said(ratios, ".2f")
            rows.append([f"{FLIGHTS[flight]}: {KINDS[kind]}", *cells])
    against = f"commit {told['against']} [µs]"
    titles = ["steps", against, "now [µs]", "ratios"]
    by = f"`python bench/c_step --against {told['against']} --steps {told['steps']}`"
    head = f"{by}, {told['machine']}; median, p99 and p99.9:"
    return f"{head}\n\n{table(titles, rows)}"


def qps(bench: dict[str, Any]) -> str:
    """Ratios of QP solvers, and how far their inputs are from ours."""
    rows = []
    for mode, flights in bench["qp"].items():
        for flight, by in flights.items():
            for name, figures in by.items():
                if name == "gtmr":
                    continue
                row = [f"{mode}, {FLIGHTS[flight]}", name]
                row += [said((figures[q] for q in ("median", "p99")), ".3f")]
                row += [said((figures[q] for q in ("ratio", "ratio p99")), ".1f")]
                rows.append([*row, f"{figures['difference']:.0e}"])
    titles = ["steps", "solver", "median, p99 [ms]", "ratios to our whole step", "differs by"]
    return f"{source(bench)}:\n\n{table(titles, rows)}"


def spread(flights: dict[str, Any], names: tuple[str, ...]) -> tuple[float, float]:
    """Least and largest ratio of medians over flights."""
    ratios = [by[name]["ratio"] for by in flights.values() for name in names if name in by]
    return min(ratios), max(ratios)


def general(bench: dict[str, Any]) -> str:
    """Ratios of general solvers over the flights."""
    names = next(iter(bench["rivals"].values()))
    rows = []
    for name, what in SOLVERS.items():
        if name in names:
            least, most = spread(bench["rivals"], (name,))
            rows.append([what, f"{least:.0f} to {most:.0f}"])
    return f"{source(bench)}:\n\n{table(['instead', 'ratio'], rows)}"


def readme(bench: dict[str, Any]) -> str:
    """Five lines for README: two steps, and three kinds of solvers."""
    rows = []
    for flight, name, what in (
        ("calm", "nominal", "nominal, calm flight"),
        ("at the limit", "frozen", "robust, gusts at their bound towards the tower"),
    ):
        step = bench["controller"][flight][name]["step"]
        rows.append([what, f"{step['median']:.3f} ms", f"{step['p99.9']:.3f} ms"])
    every_qp = {
        f"{mode} {flight}": by
        for mode, flights in bench["qp"].items()
        for flight, by in flights.items()
    }
    for flights, names, what, form in (
        (every_qp, ("DAQP",), "DAQP, its condensed QP alone", ".1f"),
        (every_qp, ("PIQP",), "PIQP, its sparse QP alone", ".0f"),
        (bench["rivals"], tuple(SOLVERS), "CasADi with qpOASES or IPOPT, do-mpc", ".0f"),
    ):
        least, most = (format(ratio, form) for ratio in spread(flights, names))
        rows.append([what, f"{least} to {most} times as long", ""])
    return f"{source(bench)}:\n\n{table(['step', 'median', '99.9 %'], rows)}"


def put(text: str, tables: dict[str, str], place: Path) -> str:
    """Put tables between their markers."""
    for name, rows in tables.items():
        pattern = re.compile(f"<!-- {name} -->\n.*?<!-- end -->", re.DOTALL)
        whole = f"<!-- {name} -->\n\n{rows}\n<!-- end -->"
        text, found = pattern.subn(lambda _, whole=whole: whole, text)
        if found != 1:
            raise SystemExit(f"{place}: {found} places for {name}")
    return text


def pages(kept: dict[str, Any]) -> dict[Path, str]:
    """Make the pages again with what was kept."""
    bench = kept["bench"]
    tables = {
        PAGE: {
            "steps": steps(bench),
            "in-c": from_python(bench),
            "c-step": c_steps(kept["c_step"]),
            "qp": qps(bench),
            "general": general(bench),
        },
        README: {"speed": readme(bench)},
    }
    return {
        place: put(place.read_text(encoding="utf-8"), of_place, place)
        for place, of_place in tables.items()
    }


def main() -> None:
    """Keep what the files say, and write the pages."""
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    for file in map(Path, sys.argv[1:]):
        kept = keep(kept, file)
    made = pages(kept)
    KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    for place, text in made.items():
        place.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
