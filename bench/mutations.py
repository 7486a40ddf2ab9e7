# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Break the code in one place at a time, and see that the test named for it fails.

Run with ``python bench/mutations.py`` (a few minutes), or with words to pick the mutations whose
file or test has them. Works on a copy; the table in docs/testing.md is this list:
``python bench/mutations.py --table`` prints it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

C = "src/gtmr_nmpc/compiled/c"
COMPILED = "tests/nmpc/test_compiled.py::test_"
CONTROLLER = "tests/nmpc/test_controller.py::test_"
IN_C = "tests/nmpc/test_step_in_c.py::test_"
PASSES = "tests/nmpc/test_passes.py::test_"
SENSITIVITY = "tests/nmpc/test_sensitivity.py::test_"
MESSAGES = "tests/msgs/test_messages.py::test_"
GUESSES = "tests/nmpc/test_guesses.py::test_"
LOOP = "tests/study/test_faults.py::test_what_is_promised_in_the_loop_is_kept"
FUZZ = "tests/fuzz/test_fuzz.py::test_"
MUTATIONS = [
    # File, text, what it becomes, test that fails.
    (
        f"{C}/feedback.c",
        "return breaks_rotor_limits(c, LIMIT_TOLERANCE_HZ_S, LIMIT_TOLERANCE_HZ);",
        "return 0;",
        COMPILED + "a_plan_that_is_called_solved_keeps_the_rotor_limits_from_anywhere",
    ),
    (
        f"{C}/feedback.c",
        "return !breaks_rotor_limits(c, INPUT_ROUNDING, SPEED_ROUNDING);",
        "return 1;",
        COMPILED + "plans_are_those_of_the_reference_with_qpoases[clearance, frozen]",
    ),
    (
        f"{C}/active_set.c",
        "REFINEMENTS = 2",
        "REFINEMENTS = 0",
        COMPILED + "digits_that_the_gram_matrix_loses_come_back",
    ),
    (
        f"{C}/active_set.c",
        "? gtmr_compliance(c, a)",
        "? 2.0 * gtmr_compliance(c, a)",
        COMPILED + "plans_are_those_of_the_reference_with_qpoases",
    ),
    (
        f"{C}/active_set.c",
        "if (changes_sides) {",
        "if (0 * changes_sides) {",
        PASSES + "clearances_that_are_all_at_their_cap_do_not_go_round_in_circles",
    ),
    (
        f"{C}/held.c",
        "g[BODY + rotor] += slope * g[N_X + rotor];",
        "(void)g;",
        GUESSES + "a_few_guesses_solve_what_has_a_hundred_active_rows[nominal-frozen]",
    ),
    (
        f"{C}/pivoting.c",
        "if (last_change == NONE && !more) {",
        "if (last_change == NONE) {",
        GUESSES + "a_clearance_that_did_not_count_at_first_is_kept",
    ),
    (
        f"{C}/feedback.c",
        "} while (gtmr_count_broken(c, along));",
        "} while (0);",
        GUESSES + "a_clearance_that_another_one_breaks_is_kept",
    ),
    (
        f"{C}/condense.c",
        "add_products(&s->at_zero[i], s->by_input[i], at->offset, LD_U);",
        "(void)at;",
        GUESSES + "a_few_guesses_solve_what_has_a_hundred_active_rows[nominal-frozen]",
    ),
    (
        f"{C}/pivoting.c",
        "        settle_out_of_reach(c);",
        "        (void)settle_out_of_reach;",
        GUESSES + "a_few_guesses_solve_what_has_a_hundred_active_rows[robust-frozen]",
    ),
    (
        f"{C}/pivoting.c",
        "SWAPS = 3",
        "SWAPS = 99",
        GUESSES + "a_few_guesses_solve_what_has_a_hundred_active_rows[robust-frozen]",
    ),
    (
        f"{C}/rollout.c",
        "keep_within(c, i, now);",
        "(void)keep_within;",
        PASSES + "a_step_that_is_stopped_returns_a_plan_within_the_limits_of_the_rotors",
    ),
    (
        f"{C}/margins.c",
        "> ZERO_MARGIN",
        "> 0.0",
        COMPILED + "rounding_decides_no_plan_where_a_margin_is_zero_by_symmetry",
    ),
    (
        f"{C}/margins.c",
        "gust_m * i * i",
        "gust_m * i",
        COMPILED + "other_vehicles",
    ),
    (
        f"{C}/riccati.h",
        "g[N_X + j] += 2.0 *",
        "g[N_X + j] += 1.0 *",
        COMPILED + "other_vehicles",
    ),
    (
        "src/gtmr_codegen/c_source.py",
        'ca.OP_TWICE: "{0} + {0}"',
        'ca.OP_TWICE: "{0} * {0}"',
        COMPILED + "other_vehicles",
    ),
    (
        "src/gtmr_nmpc/reference/qp.py",
        "<= self.slack_l1",
        "<= 10.0 * self.slack_l1",
        COMPILED + "a_clearance_row_gives_way_once_its_multiplier_would_exceed_the_linear_penalty",
    ),
    (
        "src/gtmr_nmpc/margins/paper.py",
        "0.5 * uncertainty.gust_n",
        "uncertainty.gust_n",
        SENSITIVITY + "alpha_g_is_double_integration_of_the_bound",
    ),
    (
        "src/gtmr_nmpc/margins/paper.py",
        "return np.abs(pi_y) *",
        "return pi_y *",
        SENSITIVITY + "alpha_p_is_the_worst_vertex",
    ),
    (
        "src/gtmr_nmpc/online/stepper.py",
        "> tower.radius_m + tower.min_clearance_m",
        "> 10.0 * (tower.radius_m + tower.min_clearance_m)",
        CONTROLLER + "after_an_unfit_plan_the_next_step_starts_from_the_measured_state",
    ),
    (
        f"{C}/step.c",
        "plan[i * N_X + PITCH]) < PI / 2.0",
        "plan[i * N_X + PITCH]) < HUGE_VAL",
        CONTROLLER + "a_plan_that_turns_over_does_not_turn_the_next_command_around",
    ),
    (
        "src/gtmr_nmpc/online/performance.py",
        "solution.timing.total_s > self._deadline_s",
        "solution.timing.feedback_s > self._deadline_s",
        "tests/nmpc/test_performance.py::test_both_phases_together_must_keep_the_deadline",
    ),
    (
        "src/gtmr_msgs_py/wire/fixed_cdr.py",
        "if rest == self._bytes else None",
        "if True else None",
        MESSAGES + "another_layout_of_the_same_length_is_not_taken_for_ours",
    ),
    (
        "src/gtmr_msgs_py/messages/odometry.py",
        "attitude.rotation(q).T @",
        "attitude.rotation(q) @",
        MESSAGES + "packed_odometry_is_the_message_and_reads_as_it_does",
    ),
    (
        "src/gtmr_msgs_py/messages/rotor_states.py",
        "_finite(speeds / RAD_PER_TURN)",
        "_finite(speeds)",
        MESSAGES + "packed_rotor_states_are_the_message_and_read_as_it_does",
    ),
    (
        "src/gtmr_msgs_py/wire/attitude.py",
        "math.atan2(-r[2, 0],",
        "math.atan2(r[2, 0],",
        MESSAGES + "attitude_comes_back_but_for_whole_turns",
    ),
    (
        "src/gtmr_msgs_py/wire/order.py",
        "newest_ns - stamp_ns > RESET_NS",
        "newest_ns - stamp_ns > 0",
        "tests/msgs/test_order.py::test_what_comes_behind_the_newest_is_late_however_often",
    ),
    (
        "src/gtmr_monitor/residual.py",
        '"violated": high > 0.0',
        '"violated": high >= 0.0',
        "tests/monitor/test_residual.py::test_at_exactly_the_minimum_clearance_nothing_is_violated",
    ),
    (
        "src/gtmr_monitor/bag/reader.py",
        "breakup_chunk(record, validate_crc=True)",
        "breakup_chunk(record, validate_crc=False)",
        "tests/monitor/test_bag.py::test_damaged_anywhere_it_never_gives_a_message_that_was_not_written",
    ),
    (
        "src/gtmr_model/tower.py",
        "self.min_clearance_m - self.clearance(position)",
        "self.clearance(position) - self.min_clearance_m",
        "tests/monitor/test_residual.py::"
        "test_of_positions_around_the_tower_agrees_with_the_distance_to_its_axis",
    ),
    (
        "src/gtmr_sim/session.py",
        "<= age_ns <= MAX_DELAY_NS + self.delay_ns",
        "<= age_ns <= 100 * MAX_DELAY_NS + self.delay_ns",
        "tests/sim/test_session.py::test_a_plan_for_a_state_too_old_is_not_taken",
    ),
    (
        "src/gtmr_sim/session.py",
        "if not -self.delay_ns <= age_ns",
        "if not -(10**18) <= age_ns",
        LOOP + "[commands-from-future]",
    ),
    (
        "src/gtmr_guard/c/gtmr_guard.c",
        "if (!(fabs(u_due[i]) <= k->max_command_hz_s))",
        "if (0)",
        "tests/guard/test_law.py::"
        "test_a_command_that_cannot_be_used_puts_it_in_charge_within_two_steps",
    ),
    (
        "src/gtmr_guard/c/gtmr_guard.c",
        "cause = GTMR_GUARD_ENDED;",
        "cause = GTMR_GUARD_NONE;",
        "tests/guard/test_guarded_flights.py::"
        "test_with_the_controller_dead_it_hovers_clear_of_the_tower",
    ),
    (
        "src/gtmr_guard/c/gtmr_guard.c",
        "if (g->R[2][2] < k->min_tilt_cosine)",
        "if (0)",
        "tests/guard/test_law.py::"
        "test_it_overrides_fresh_plans_beyond_what_any_controller_is_trusted_with",
    ),
    (
        "src/gtmr_msgs_py/wire/order.py",
        "if self._asides < LASTING or",
        "if self._asides < 1 or",
        "tests/msgs/test_order.py::test_one_stray_message_of_the_past_is_no_reset",
    ),
    (
        "src/gtmr_msgs_py/wire/reading.py",
        "except Exception",
        "except ValueError",
        FUZZ + "damaged_messages_are_refused_by_a_message_error",
    ),
    (
        "src/gtmr_model/yaml_file.py",
        "MAX_DEPTH = 20",
        "MAX_DEPTH = 10**9",
        FUZZ + "files_are_read_as_far_as_they_go_or_refused_in_one_line[yaml-hostile]",
    ),
    (
        "src/gtmr_monitor/coverage.py",
        "return not (self.gaps or self.causes or self.lost_messages)",
        "return True",
        "tests/study/test_faults.py::test_what_is_promised_of_files_is_kept[bag-cut]",
    ),
    (
        "src/gtmr_study/faults/campaign.py",
        'row["held"] < row["tried"]',
        'row["held"] > row["tried"]',
        "tests/study/test_faults.py::test_the_command_fails_when_a_promise_is_broken",
    ),
    (
        "src/gtmr_nmpc/compiled/c/observer.c",
        "o->theta[j] *= decay;",
        "o->theta[j] *= 1.0;",
        "tests/nmpc/test_observer.py::test_compiled_and_numpy_are_the_same",
    ),
    (
        "src/gtmr_nmpc/observer.py",
        "np.clip(self._theta, -self._bounds, self._bounds, out=self._theta)",
        "np.clip(self._theta, -1e9, 1e9, out=self._theta)",
        "tests/nmpc/test_observer.py::"
        "test_a_vehicle_held_by_the_ground_winds_up_no_further_than_the_bounds",
    ),
    (
        f"{C}/sent.c",
        "sent(c, 1)->start_s <= oldest_s",
        "sent(c, 1)->start_s <= start_s",
        IN_C + "a_flight_is_the_same_to_the_last_digit[nominal-hard]",
    ),
    (
        f"{C}/step.c",
        "p->theta[j] *= exp(",
        "p->theta[j] *= 1.0 + 0.0 * exp(",
        IN_C + "a_flight_is_the_same_to_the_last_digit[offset_free-field]",
    ),
    (
        f"{C}/step.c",
        "if (offset_free == 0.0 && p->offset_free != 0.0)",
        "if (0)",
        IN_C + "switches_margins_of_ones_own_and_resets_are_the_same_too[frozen-None]",
    ),
    (
        "src/gtmr_nmpc/compiled/stepper.py",
        "self._plan.copy()",
        "self._plan",
        COMPILED + "controllers_in_one_process_do_not_disturb_each_other",
    ),
    (
        "src/gtmr_nmpc/online/sent.py",
        "last = last - behind + (xi - first + behind)",
        "last = last + (xi - first)",
        "tests/nmpc/test_closed_loop.py::test_the_rotors_are_predicted_as_a_lagging_motor_turns",
    ),
    (
        "src/gtmr_nmpc/closed_loop.py",
        "theta[BIAS] += parts[2]",
        "theta[BIAS] += 0.5 * parts[2]",
        "tests/nmpc/test_closed_loop.py::"
        "test_the_linear_loop_answers_a_gust_as_the_controller_does",
    ),
    (
        "src/gtmr_monitor/bag/flight.py",
        "truth = recording.ground_truth or odometry",
        "truth = odometry",
        "tests/monitor/test_flight.py::"
        "test_clearance_is_that_of_the_true_state_where_it_was_recorded",
    ),
]


def passes(root: Path, *tests: str) -> bool:
    """Whether tests pass in a copy of the project."""
    environment = os.environ | {"PYTHONPATH": str(root / "src"), "XDG_CACHE_HOME": str(root)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    if run.returncode not in (0, 1):
        raise SystemExit(f"{tests} do not run:\n{run.stdout[-2000:]}{run.stderr[-2000:]}")
    return run.returncode == 0


def is_caught(root: Path, mutation: tuple[str, str, str, str]) -> bool:
    """Whether the test fails once the text is replaced."""
    name, text, other, test = mutation
    path = root / name
    before = path.read_text(encoding="utf-8")
    if before.count(text) != 1:
        raise SystemExit(f"{name}: {text!r} stands there {before.count(text)} times, not once")
    path.write_text(before.replace(text, other), encoding="utf-8")
    passed = passes(root, test)
    path.write_text(before, encoding="utf-8")
    return not passed


def main(words: list[str]) -> int:
    """Print the table, or try the mutations that were asked for; 1 if one is not caught."""
    if words == ["--table"]:
        print("| file | text | becomes | caught by |\n|---|---|---|---|")
        for name, text, other, test in MUTATIONS:
            print(f"| `{name}` | `{text}` | `{other}` | `{test.partition('::')[2]}` |")
        return 0
    escaped = 0
    with tempfile.TemporaryDirectory() as folder:
        root, here = Path(folder), Path(__file__).resolve().parent.parent
        for part in ("src", "tests", "bench", "config", "bags", "pyproject.toml"):
            copy = shutil.copytree if (here / part).is_dir() else shutil.copy
            copy(here / part, root / part)
        chosen = [
            mutation
            for mutation in MUTATIONS
            if not words or any(word in mutation[0] + mutation[3] for word in words)
        ]
        if not passes(root, *sorted({test for *_, test in chosen})):
            raise SystemExit("the tests fail without a mutation")
        for mutation in chosen:
            caught = is_caught(root, mutation)
            escaped += not caught
            print("caught" if caught else "ESCAPED", *mutation[:3], sep=" | ", flush=True)
    return min(escaped, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
