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

/*
 * Put in what held inputs are, du = offset + slope dxi of the rotor: they leave the Hessian and
 * the gradient. `added` is what that adds to the rows of the rotors' speeds.
 */
static void substitute(const law *at, const signed char *held, double H[N_U][LD_XU], double *g,
                       double added[N_U][LD_X])
{
    memset(added, 0, N_U * sizeof added[0]);
    for (int r = 0; r < N_U; ++r) {
        const double offset = at->offset[r], slope = at->slope[r], own = H[r][N_X + r];
        if (held[r] == FREE) {
            continue;
        }
        const double change = slope * (g[N_X + r] + own * offset);
        for (int j = 0; j < N_XU; ++j) {
            g[j] += offset * H[r][j];
        }
        g[BODY + r] += change;
        if (slope != 0.0) {
            for (int j = 0; j < N_X; ++j) {
                added[r][j] += slope * H[r][j];
            }
            for (int s = 0; s < N_U; ++s) {
                added[s][BODY + r] += slope * H[r][BODY + s];
                H[s][BODY + r] += slope * H[s][N_X + r];
            }
            added[r][BODY + r] += slope * slope * own;
        }
        memset(H[r], 0, sizeof H[r]);
        for (int s = 0; s < N_U; ++s) {
            H[s][N_X + r] = 0.0;
        }
        H[r][N_X + r] = 1.0;
        g[N_X + r] = 0.0;
    }
}

/* The cost to go behind a stage, which is where what is held ends, or was left by the last guess. */
static void begin_behind(const gtmr_controller *c, int stage, value_function *to)
{
    const int behind = stage + 1;
    if (behind == STAGES) {
        at_the_end(c, to);
    } else if (behind < c->held_stages) {
        copy_value(&c->to_go[behind], to);
    } else {
        copy_value(&c->checkpoints[behind / CHECKPOINT], to);
    }
}

void gtmr_riccati_factorise_held(gtmr_controller *c, int last_change)
{
    ALIGNED value_function to_go;
    ALIGNED hessian H;
    ALIGNED double g[LD_XU], added[N_U][LD_X];
    int from = last_change;
    if (from >= c->held_stages) {
        const int checkpoint = (from / CHECKPOINT + 1) * CHECKPOINT;
        c->held_stages = checkpoint < STAGES ? checkpoint : STAGES;
        from = c->held_stages - 1;
    }
    weigh(c, &H);
    begin_behind(c, from, &to_go);
    for (int i = from; i >= 0; --i) {
        const interval *stage = &c->intervals[i];
        const signed char *held = c->held[i];
        law *at = &c->held_laws[i];
        carry_back(c, stage, &to_go, &H);
        gradient(c, i, &to_go, g);
        input_rows(stage, &H);
        memcpy(c->input_costs[i].Q, H.of_input, sizeof H.of_input);
        memcpy(c->input_costs[i].q, g + N_X, sizeof at->z);
        substitute(at, held, H.of_input, g, added);
        eliminate(H.of_input, g + N_X);
        state_rows(stage, &H, to_go.P);
        for (int r = 0; r < N_U; ++r) {
            memcpy(at->Z[r], H.of_input[r], N_X * sizeof(double));
            add_scaled(to_go.P[BODY + r], 1.0, added[r], LD_X);
        }
        memcpy(at->z, g + N_X, sizeof at->z);
        whiten(H.of_input, at->whitening);
        for (int r = 0; r < N_U; ++r) {
            at->whitening[r][r] = held[r] == FREE ? at->whitening[r][r] : 0.0;
        }
        reduce(at, g, &to_go);
        mirror(&to_go);
        copy_value(&to_go, &c->to_go[i]);
    }
}
