// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * The QP without its inequalities, solved by Riccati recursion.
 *
 * With u = K x + k + C' v at every stage its cost is |v|^2 / 2: v = 0 is its solution, and the
 * inequalities become rows in v. With Z = C H_ux and z = C g_u it is u = C' (v - z - Z x), which
 * is all that a roll-out needs.
 */
#include "riccati.h"

void gtmr_riccati_factorise(gtmr_controller *c)
{
    ALIGNED value_function to_go;
    ALIGNED hessian H;
    ALIGNED double g[LD_XU];
    weigh(c, &H);
    at_the_end(c, &to_go);
    for (int i = STAGES - 1; i >= 0; --i) {
        const interval *stage = &c->intervals[i];
        law *at = &c->laws[i];
        const int goes_on = i > 0; /* Nobody asks for the cost to go of stage 0. */
        carry_back(c, stage, &to_go, &H);
        gradient(c, i, &to_go, g);
        begin_inputs(stage, &H);
        eliminate(H.of_input, g + N_X);
        if (goes_on) {
            state_rows(stage, &H, to_go.P);
        }
        keep_law((const double(*)[LD_XU + LD_U])H.of_input, g + N_X, at);
        if (goes_on) {
            reduce(at, g, &to_go);
            mirror(&to_go);
        }
        if (goes_on && i % CHECKPOINT == 0) {
            copy_value(&to_go, &c->checkpoints[i / CHECKPOINT]);
        }
    }
}

/* K = -C' Z. */
void gtmr_riccati_gain(const law *at, double K[N_U][LD_X])
{
    double C[N_U][N_U];
    for (int r = 0; r < N_U; ++r) {
        for (int k = 0; k < N_U; ++k) {
            C[r][k] = k < r ? 0.0 : -at->whitening[k][r];
        }
    }
    memset(K, 0, N_U * sizeof K[0]);
    const coefficients by = {C[0], N_U, 1};
    combine(N_U, LD_X, N_U, by, at->Z[0], LD_X, K[0], LD_X);
}
