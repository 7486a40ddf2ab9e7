# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Time of the C step against that of another commit: ``python bench/c_step --against COMMIT``.

Both are built here and driven along the same recorded states in turns; of every step the least
time counts. Takes about two minutes. With ``--json FILE`` its figures are for docs/performance.py.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from gtmr_codegen.library import FLAGS
from gtmr_nmpc import ControllerConfig
from gtmr_study.result_files import InputError, require_folder_of, write_json
from gtmr_study.solvers.bench import machine
from gtmr_study.solvers.situations import record_situations

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
KINDS = (("nominal", 0.0, "frozen"), ("robust", 1.0, "frozen"), ("gradient", 1.0, "gradient"))
"""Name, margin scale, tightening."""
PERCENTILES = (50.0, 99.0, 99.9)
"""Of the steps of a situation, told of both builds."""


def build(source: Path, folder: Path) -> Path:
    """Generate and compile the controller of a checkout, with the driver."""
    folder.mkdir()
    subprocess.run(
        [sys.executable, HERE / "dump.py", folder],
        check=True, env={"PYTHONPATH": str(source), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    objects = []
    units = dict(
        line.split(" ", 1) for line in (folder / "flags").read_text(encoding="utf-8").splitlines()
    )
    (folder / "drive.c").write_bytes((HERE / "drive.c").read_bytes())
    for name, flags in {**units, "drive.c": "-O2"}.items():
        objects.append(folder / f"{name}.o")
        command = ["cc", *FLAGS, *flags.split(), "-c", folder / name, "-o", objects[-1]]
        subprocess.run(command, check=True)
    subprocess.run(["cc", "-o", folder / "drive", *objects, "-lm"], check=True)
    return folder


def drive(built: Path, states: np.ndarray, scale: float, tightening: str, repeats: int):
    """Time every step: total, warm start, preparation, feedback [ns], status, first input."""
    parameters = (built / f"{tightening}.parameters").read_bytes()
    config = ControllerConfig()
    reach_m = config.tower.radius_m + config.tower.min_clearance_m
    head = np.array(
        [states.shape[1] - 1, len(states), len(parameters), scale, reach_m, config.horizon]
    )
    (built / "in").write_bytes(head.tobytes() + parameters + states.tobytes())
    subprocess.run([built / "drive", built / "in", built / "out", str(repeats)], check=True)
    return np.fromfile(built / "out").reshape(len(states), -1)


def main() -> None:
    """Print a line for each situation and kind of margin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", default="03094d4", help="commit to compare with")
    parser.add_argument("--steps", type=int, default=2000, help="of each situation")
    parser.add_argument("--turns", type=int, default=4, help="of the two builds")
    parser.add_argument("--repeats", type=int, default=5, help="of each step and turn")
    parser.add_argument("--json", type=Path, help="where the figures go")
    given = parser.parse_args()
    try:
        require_folder_of("--json", given.json)
    except InputError as error:
        parser.error(str(error))
    result = {"machine": machine(), "against": given.against, "steps": given.steps, "c_step": {}}
    print(result["machine"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        old = folder / "checkout"
        subprocess.run(["git", "worktree", "add", "-q", "--detach", old, given.against],
                       check=True, cwd=ROOT)  # fmt: skip
        try:
            builds = [build(old / "src", folder / "old"), build(ROOT / "src", folder / "new")]
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", old], check=True, cwd=ROOT)
        print(f"{'microseconds':24}{'then: 50 %, 99 %, 99.9 %':>28}{'now':>24}{'ratios':>22}"
              f"{'now: warm, prepare, feedback':>32}")  # fmt: skip
        for situation in record_situations(given.steps):
            states = np.array([[t, *x] for t, x in situation.steps])
            for kind, scale, tightening in KINDS:
                runs = [
                    [drive(built, states, scale, tightening, given.repeats) for built in builds]
                    for _ in range(given.turns)
                ]
                least = np.min([[run[:, :4] for run in turn] for turn in runs], axis=0)
                then, now = 1e-3 * np.percentile(least[:, 20:, 0], PERCENTILES, axis=1).T
                phases = 1e-3 * np.median(least[1, 20:, 1:], axis=0)
                differs = float(np.abs(runs[0][0][:, 5] - runs[0][1][:, 5]).max())
                figures = (
                    "".join(f"{v:9.1f}" for v in then)
                    + "  "
                    + "".join(f"{v:8.1f}" for v in now)
                    + "".join(f"{v:7.2f}" for v in now / then)
                )
                print(f"{situation.name + ', ' + kind:24}{figures}   "
                      + "".join(f"{v:7.1f}" for v in phases) + f"   {differs:.1e}")  # fmt: skip
                result["c_step"].setdefault(situation.name, {})[kind] = {
                    "then_us": then.tolist(),
                    "now_us": now.tolist(),
                    "phases_us": phases.tolist(),
                    "difference_hz_s": differs,
                }
    write_json(given.json, result)


if __name__ == "__main__":
    main()
