// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The Riccati recursion where inputs are held: they follow from the state, and have no part in what
 * a stage decides. Only stages up to the last one where what is held changed are done again.
 */
#include "riccati.h"

/* Rows of [x u] with a 1 where an input is. */
typedef double units[N_U][LD_XU];

/* An input that follows from its rotor's speed; `added` is for the rows of the speeds. */
static void add_slope(const law *at, int rotor, input_rows H, double *g, double added[N_U][LD_X])
{
    const double slope = at->slope[rotor], own = H[rotor][N_X + rotor];
    g[BODY + rotor] += slope * g[N_X + rotor];
    for (int j = 0; j < N_X; ++j) {
        added[rotor][j] += slope * H[rotor][j];
    }
    for (int s = 0; s < N_U; ++s) {
        added[s][BODY + rotor] += slope * H[rotor][BODY + s];
        H[s][BODY + rotor] += slope * H[s][N_X + rotor];
    }
    added[rotor][BODY + rotor] += slope * slope * own;
}

/*
 * Put in what held inputs are, du = offset + slope dxi of the rotor: they leave the Hessian and
 * the gradient. In whole registers, as the elimination reads them next.
 */
static void substitute(const law *at, const signed char *held, const units unit, input_rows H,
                       double *g, double added[N_U][LD_X])
{
    ALIGNED double free[LD_XU];
    for (int j = 0; j < LD_XU; j += VEC) {
        store(free + j, vec_of(1.0));
    }
    for (int r = 0; r < N_U; ++r) {
        if (held[r] != FREE) {
            add_scaled(g, at->offset[r], H[r], LD_XU);
            if (at->slope[r] != 0.0) {
                add_slope(at, r, H, g, added);
            }
            add_scaled(free, -1.0, unit[r], LD_XU);
        }
    }
    for (int j = 0; j < LD_XU; j += VEC) {
        store(g + j, load(free + j) * load(g + j));
    }
    for (int r = 0; r < N_U; ++r) {
        for (int j = 0; j < LD_XU; j += VEC) {
            const vec row = load(free + j) * load(H[r] + j);
            store(H[r] + j, held[r] == FREE ? row : load(unit[r] + j));
        }
    }
}

/* The cost to go behind a stage, which is where what is held ends, or was left by the last guess. */
static const value_function *behind(const gtmr_controller *c, int stage, value_function *end)
{
    const int next = stage + 1;
    if (next == STAGES) {
        at_the_end(c, end);
        return end;
    }
    return next < c->held_stages ? &c->to_go[next] : &c->checkpoints[next / CHECKPOINT];
}

void gtmr_riccati_factorise_held(gtmr_controller *c, int last_change)
{
    ALIGNED value_function end;
    ALIGNED hessian H;
    ALIGNED double g[LD_XU], added[N_U][LD_X];
    ALIGNED units unit = {{0.0}};
    int from = last_change;
    if (from >= c->held_stages) {
        const int checkpoint = (from / CHECKPOINT + 1) * CHECKPOINT;
        c->held_stages = checkpoint < STAGES ? checkpoint : STAGES;
        from = c->held_stages - 1;
    }
    for (int r = 0; r < N_U; ++r) {
        unit[r][N_X + r] = 1.0;
    }
    weigh(c, &H);
    const value_function *next = behind(c, from, &end);
    for (int i = from; i >= 0; --i) {
        const interval *stage = &c->intervals[i];
        const signed char *held = c->held[i];
        law *at = &c->held_laws[i];
        value_function *to_go = &c->to_go[i];
        carry_back(c, stage, next, &H);
        gradient(c, i, next, g);
        begin_inputs(stage, &H);
        for (int r = 0; r < N_U; ++r) {
            memcpy(c->input_costs[i].Q[r], H.of_input[r], sizeof c->input_costs[i].Q[r]);
        }
        memcpy(c->input_costs[i].q, g + N_X, sizeof c->input_costs[i].q);
        if (has_slopes(at)) {
            memset(added, 0, sizeof added);
        }
        substitute(at, held, (const double(*)[LD_XU])unit, H.of_input, g, added);
        eliminate(H.of_input, g + N_X);
        if (i > 0) {
            state_rows(stage, &H, to_go->P);
        }
        keep_law((const double(*)[LD_XU + LD_U])H.of_input, g + N_X, at);
        for (int r = 0; r < N_U; ++r) {
            at->whitening[r][r] = held[r] == FREE ? at->whitening[r][r] : 0.0;
        }
        if (i > 0) {
            for (int r = 0; r < N_U && has_slopes(at); ++r) {
                add_scaled(to_go->P[BODY + r], 1.0, added[r], LD_X);
            }
            reduce(at, g, to_go);
            mirror(to_go);
            next = to_go;
        }
    }
}
