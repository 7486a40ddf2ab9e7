# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The C sources of one problem: its dimensions and model, generated; the rest as written."""

import math
from importlib.resources import files

import casadi as ca
import numpy as np

from gtmr_codegen.c_source import c_function
from gtmr_model import N_ZETA, ConfigError
from gtmr_model.dynamics import RATE, ROTORS, one_at_a_time, rk4_step, state_derivative, symbols
from gtmr_model.reference import reference_function
from gtmr_nmpc import observer, ocp, sensitivity
from gtmr_nmpc.config import ControllerConfig

BODY = slice(0, ROTORS.start)
"""The states with dynamics of their own in x; the rotor speeds integrate the inputs."""
MAX_REFERENCE_NUMBERS = 16
"""Room for the numbers of a reference in ``gtmr_parameters``."""
GENERATED_FLAGS = ("-O2", "-ffp-contract=fast", "-Wno-unused-variable")
"""Straight-line code: -O3 finds nothing more in it, and takes longer."""
WRITTEN_FLAGS = ("-O3", "-ffp-contract=fast")
UNFUSED = ("step.c", "sent.c")
"""Files whose arithmetic rounds as in Python, each operation by itself."""
UNFUSED_FLAGS = ("-O3", "-ffp-contract=off", "-D_POSIX_C_SOURCE=199309L")
"""Those of them; POSIX has a clock that C99 has not."""
LONGEST_DELAY_S = 0.5
"""Up to this age of a state all plans are kept that were sent since, one every T_s [s]; of older
ones the newest 256 at most."""


@one_at_a_time
def c_sources(config: ControllerConfig) -> dict[str, str]:
    """All sources of the controller of a problem, by file name.

    They depend on the vehicle, the reference's form, T_s, N and ``clearance_of`` alone; all else
    is in ``gtmr_parameters``.
    """
    folder = files("gtmr_nmpc.compiled") / "c"
    written = {
        entry.name: entry.read_text(encoding="utf-8")
        for entry in folder.iterdir()
        if entry.name.endswith((".c", ".h"))
    }
    return written | _model(config)


def flags(sources: dict[str, str]) -> dict[str, tuple[str, ...]]:
    """Compiler flags of each ``.c`` file."""

    def of(name: str) -> tuple[str, ...]:
        if name in UNFUSED:
            return UNFUSED_FLAGS
        return GENERATED_FLAGS if name.startswith("gtmr_model_") else WRITTEN_FLAGS

    return {name: of(name) for name in sources if name.endswith(".c")}


def _model(config: ControllerConfig) -> dict[str, str]:
    linearise, *places = _linearise(config, disturbed=False)
    disturbed, *same_places = _linearise(config, disturbed=True)
    assert places == same_places
    jacobian, dF_dzeta = places
    require_structure(jacobian)
    constraint = config.clearance_constraint
    functions = [linearise, disturbed, _bending(config), _adjoint(config)]
    by_point = [_reference(config), *_clearance(config), _motion(config)]
    sources = {
        f"{function.name()}.c": (
            f'/* Generated. */\n#include "problem.h"\n\n{c_function(function, "vec")}'
        )
        for function in functions
    }
    sources["gtmr_model_points.c"] = "/* Generated. */\n" + "\n".join(
        ["#include <math.h>\n", '#include "problem.h"\n', *(c_function(f) for f in by_point)]
    )
    lanes_in = max(sum(f.nnz_in(i) for i in range(f.n_in())) for f in functions)
    lanes_out = max(sum(f.nnz_out(i) for i in range(f.n_out())) for f in functions)
    prototypes = "\n".join(
        f"void {f.name()}(const vec *restrict in, vec *restrict out);" for f in functions
    )
    prototypes_by_point = "\n".join(
        f"void {f.name()}(const double *restrict in, double *restrict out);" for f in by_point
    )
    sources["problem.h"] = f"""\
/* Generated: dimensions and model of one problem. */
#ifndef GTMR_PROBLEM_H
#define GTMR_PROBLEM_H

#include "vec.h"

#define STAGES {config.horizon}
#define BODY {BODY.stop} /* p, eta, v, omega: the states with dynamics of their own */
#define N_H {ocp.N_H} /* outputs that the cost weighs */
#define N_ZETA {N_ZETA}
#define CLEARANCE_LENGTH {constraint.length} /* first states that the clearance is told */
#define CLEARANCE_STATES {len(constraint.states)} /* those that it depends on */
#define CLEARANCE_STATE_LIST {", ".join(map(str, constraint.states))}
#define ROTORS {config.vehicle.n_rotors}
#define PERIOD_S {config.sampling_time_s!r}
#define SENT_PLANS {min(256, math.ceil(LONGEST_DELAY_S / config.sampling_time_s) + 3)}
#define MODEL_LANES_IN {lanes_in}
#define MODEL_LANES_OUT {lanes_out}

/* (x, u) -> F without rotors, acceleration, their Jacobian in (x, u), dF/dzeta; one interval a
 * lane, nonzeros only. The same of (x, u, force, torque). (x, u, Pi s, s, dx, du) -> second
 * derivative of F along both directions. (x, u, lambda, Pi s, s) -> gradient of
 * lambda' (dF/dx Pi s + dF/dzeta s) in (x, u). */
{prototypes}

/* One point a call. (t, R, d_min, numbers of the reference) -> r, in the order of h. (x, R,
 * d_min), x the first states -> y and J_yx, (x, direction) -> d(J_yx direction)/dx, both by the
 * states of CLEARANCE_STATE_LIST.
 * (x, u, force, torque, dt) -> F without rotors, over dt. */
{prototypes_by_point}

/* h, eq. (6): the state that an output is, or none, and then it is an acceleration. */
#define OUTPUT_STATES {_output_states(config)}

/* Which nonzero goes where, in rows of ld entries, row by row. */
#define JACOBIAN_NONZEROS {jacobian.nnz()}
#define JACOBIAN_MOVES(ld) {_moves(jacobian)}
#define DF_DZETA_NONZEROS {dF_dzeta.nnz()}
#define DF_DZETA_MOVES(ld) {_moves(dF_dzeta)}

#endif
"""
    return sources


def require_structure(jacobian: ca.Sparsity) -> None:
    """Refuse a model whose [A B] has entries that ``riccati.h`` takes as zero.

    Body rates depend on nothing of the body but themselves, the acceleration neither on rates nor
    on inputs. Raises ValueError otherwise: the QP would be another one without a word.
    """
    rows, columns = (np.array(each, int) for each in jacobian.get_triplet())
    rates = (rows >= RATE.start) & (rows < RATE.stop)
    acceleration = rows >= BODY.stop
    n_x = jacobian.size2() - (jacobian.size2() - BODY.stop) // 2
    wrong = rates & (columns < RATE.start)
    wrong |= acceleration & (columns >= RATE.start) & (columns < RATE.stop)
    wrong |= acceleration & (columns >= n_x)
    if wrong.any():
        places = sorted(set(zip(rows[wrong].tolist(), columns[wrong].tolist(), strict=True)))
        raise ValueError(f"d(F, acceleration)/d(x, u) has entries at {places}: see riccati.h")


def _moves(sparsity: ca.Sparsity) -> str:
    rows, columns = sparsity.get_triplet()
    moves = sorted(zip(rows, columns, range(sparsity.nnz()), strict=True))
    return ", ".join(f"{{{k}, {r} * (ld) + {c}}}" for r, c, k in moves)


def _linearise(
    config: ControllerConfig, disturbed: bool
) -> tuple[ca.Function, ca.Sparsity, ca.Sparsity]:
    """Write F, acceleration and their sparse Jacobians, and the latters' patterns.

    Positions pass through F unchanged, so that their columns are left out. The derivatives of an
    RK4 step are the RK4 step of the derivatives, which takes two thirds of the operations of
    differentiating the step as a whole.
    """
    vehicle = config.vehicle
    x, u, zeta, force = symbols(vehicle)
    torque = ca.SX.sym("torque", 3)
    theta = [force, torque] if disturbed else []
    x_dot = state_derivative(x, u, zeta, force, vehicle, torque)
    slopes = [x_dot, *(ca.jacobian(x_dot, by) for by in (x, u, zeta))]
    undisturbed = [] if disturbed else [force, torque]
    slopes = ca.substitute(
        slopes, [zeta, *undisturbed], [ca.DM.zeros(N_ZETA), *[ca.DM.zeros(3)] * len(undisturbed)]
    )
    slope = ca.Function("slope", [x, u, *theta], slopes)
    n_x, n_u = vehicle.n_x, vehicle.n_rotors

    def derivative(state: ca.SX) -> ca.SX:
        """Of x and, beside it, of dx/d(x, u, zeta)."""
        f, by_x, by_u, by_zeta = slope(state[:, 0], u, *theta)
        direct = ca.horzcat(ca.SX(n_x, n_x), by_u, by_zeta)
        return ca.horzcat(f, by_x @ state[:, 1:] + direct)

    start = ca.horzcat(x, ca.SX.eye(n_x), ca.SX(n_x, n_u + N_ZETA))
    end = rk4_step(start, config.sampling_time_s, derivative)[BODY, :]
    x_next, by_x_and_u, dF_dzeta = end[:, 0], end[:, 1 : 1 + n_x + n_u], end[:, 1 + n_x + n_u :]
    acceleration = ocp.output_map(config)(x)[6:9]
    if disturbed:
        acceleration += force / vehicle.mass_kg
    jacobian = ca.vertcat(by_x_and_u, ca.jacobian(acceleration, ca.vertcat(x, u)))[:, 3:]
    results = [x_next, acceleration, jacobian, dF_dzeta]
    placed = ca.horzcat(ca.SX(jacobian.size1(), 3), jacobian).sparsity()
    name = "gtmr_model_linearise_disturbed" if disturbed else "gtmr_model_linearise"
    function = ca.Function(name, [x, u, *theta], ca.cse(results))
    return function, placed, dF_dzeta.sparsity()


def _motion(config: ControllerConfig) -> ca.Function:
    """One step of any length, without rotors, which integrate the inputs."""
    motion = observer.motion(config.vehicle)
    given = [ca.SX.sym(motion.name_in(i), motion.size1_in(i)) for i in range(motion.n_in())]
    return ca.Function("gtmr_model_motion", given, ca.cse([ca.densify(motion(*given)[BODY])]))


def _reference(config: ControllerConfig) -> ca.Function:
    """R of eq. (6): level, and turning with the yaw of the reference."""
    follow = reference_function(config.helix.form)
    t, numbers = ca.SX.sym("t"), ca.SX.sym("numbers", follow.size1_in(1))
    count = len(config.helix.numbers)
    if count > MAX_REFERENCE_NUMBERS:
        raise ConfigError(
            f"helix.kind = {config.helix.kind!r}: has {count} numbers, a compiled reference has "
            f"at most {MAX_REFERENCE_NUMBERS}"
        )
    position, velocity, acceleration, yaw, yaw_rate = follow(t, numbers)
    r = ca.vertcat(position, velocity, acceleration, 0, 0, yaw, 0, 0, yaw_rate)
    return ca.Function("gtmr_model_reference", [t, numbers], [ca.densify(ca.cse(r))])


def _clearance(config: ControllerConfig) -> list[ca.Function]:
    """Write y with J_yx, and the curvature, as functions of their own; nonzeros of J_yx only."""
    constraint = config.clearance_constraint
    x, sizes, direction = (
        ca.SX.sym(n, k)
        for n, k in (("x", constraint.length), ("sizes", 2), ("d", constraint.length))
    )
    y, gradient, curvature = constraint.function(x, sizes, direction)
    bent = ca.densify(curvature[list(constraint.states)])
    return [
        ca.Function("gtmr_model_clearance", [x, sizes], ca.cse([y, gradient])),
        ca.Function("gtmr_model_curvature", [x, direction], ca.cse([bent])),
    ]


def _output_states(config: ControllerConfig) -> str:
    """Find the outputs that are states themselves by their rows of dh/dx."""
    h = ocp.output_map(config)
    x = ca.SX.sym("x", config.vehicle.n_x)
    rows = [ca.jacobian(entry, x) for entry in ca.vertsplit(h(x))]
    states = [
        row.sparsity().get_triplet()[1][0] if row.nnz() == 1 and row.is_constant() else -1
        for row in rows
    ]
    return ", ".join(str(state) for state in states)


def _bending(config: ControllerConfig) -> ca.Function:
    """(x, u, Pi s, s, dx, du) -> d/d(x, u) (dF/dx Pi s + dF/dzeta s) (dx, du)."""
    x, u, zeta, x_next = _dynamics(config)
    pi, s = ca.SX.sym("pi", x_next.numel()), ca.SX.sym("s", N_ZETA)
    dx, du = ca.SX.sym("dx", x.numel()), ca.SX.sym("du", u.numel())
    rotors = ca.DM.zeros(u.numel())
    worst = ca.jtimes(x_next, ca.vertcat(x, zeta), ca.vertcat(pi, rotors, s))
    bent = ca.jtimes(worst, ca.vertcat(x, u), ca.vertcat(dx, du))
    results = [ca.densify(r) for r in _at_nominal([bent], zeta)]
    return ca.Function("gtmr_model_bending", [x, u, pi, s, dx, du], ca.cse(results))


def _adjoint(config: ControllerConfig) -> ca.Function:
    """Second-order adjoint without the rotor speeds, which neither lambda nor Pi reaches."""
    adjoint = sensitivity.second_order_adjoint(ocp.discrete_dynamics(config))
    x, u = ca.SX.sym("x", adjoint.size1_in(0)), ca.SX.sym("u", adjoint.size1_in(1))
    lam, pi, s = (ca.SX.sym(n, k) for n, k in (("lambda", 12), ("pi", 12), ("s", N_ZETA)))
    rotors = ca.DM.zeros(u.numel())
    gradient = adjoint(x, u, ca.vertcat(lam, rotors), ca.vertcat(pi, rotors), s)
    return ca.Function("gtmr_model_adjoint", [x, u, lam, pi, s], ca.cse([ca.densify(gradient)]))


def _dynamics(config: ControllerConfig) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    dynamics = ocp.discrete_dynamics(config)
    x, u, zeta = (ca.SX.sym(name, dynamics.size1_in(name)) for name in ("x", "u", "zeta"))
    return x, u, zeta, dynamics(x, u, zeta)[BODY]


def _at_nominal(expressions: list[ca.SX], zeta: ca.SX) -> list[ca.SX]:
    return ca.substitute(expressions, [zeta], [ca.DM.zeros(N_ZETA)])
