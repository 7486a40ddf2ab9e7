// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/*
 * Drive a controller along recorded states, and write the time of every step [ns].
 *
 * drive INPUT OUTPUT REPEATS. INPUT, doubles: number of states a step, of steps, bytes of the
 * parameters, margin scale, tower radius plus least clearance; the parameters; then for each step
 * its time and state. Time falls back where a flight starts anew. A step is timed REPEATS times
 * from the same memory, and the least counts; warm start, preparation and feedback are its parts.
 */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "gtmr.h"

static double now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e9 * (double)now.tv_sec + (double)now.tv_nsec;
}

static void *aligned(size_t bytes)
{
    char *memory = calloc(1, bytes + 64);
    return memory + (64 - (size_t)memory % 64) % 64;
}

/* A plan is no start when it failed, turns over, or goes through the tower's axis. */
static int is_a_start(gtmr_status status, const double *plan, int n_x, int stages,
                      double most_slack)
{
    const int n_u = n_x - 12;
    const double *slack = plan + (stages + 1) * (n_x + 9 + 2) + stages * n_u;
    int sound = status != GTMR_FAILED;
    for (int i = 0; i <= stages; ++i) {
        sound &= fabs(plan[i * n_x + 4]) < 1.5707963267948966;
        sound &= slack[i] <= most_slack;
    }
    return sound;
}

int main(int argc, char **argv)
{
    FILE *in = fopen(argv[1], "rb"), *out = fopen(argv[2], "wb");
    const int repeats = argc > 3 ? atoi(argv[3]) : 1;
    double head[6];
    if (in == NULL || out == NULL || fread(head, sizeof head, 1, in) != 1) {
        return 1;
    }
    const int n_x = (int)head[0], steps = (int)head[1], stages = (int)head[5];
    gtmr_parameters parameters;
    if (sizeof parameters != (size_t)head[2] || fread(&parameters, sizeof parameters, 1, in) != 1) {
        return 2;
    }
    const size_t size = gtmr_size(), length = gtmr_plan_length();
    void *memory = aligned(size), *before = aligned(size);
    double *plan = aligned(length * sizeof *plan), *x = aligned(n_x * sizeof *x);
    gtmr_controller *c = gtmr_create(memory, &parameters);
    double t, last = HUGE_VAL;
    int warm = 0;
    for (int k = 0; k < steps; ++k) {
        if (fread(&t, sizeof t, 1, in) != 1 || fread(x, n_x * sizeof *x, 1, in) != 1) {
            return 3;
        }
        warm = warm && t > last;
        last = t;
        double least[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, total = HUGE_VAL;
        gtmr_status status = GTMR_FAILED;
        memcpy(before, memory, size);
        for (int r = 0; r < repeats; ++r) {
            memcpy(memory, before, size);
            const double start = now_ns();
            if (warm) {
                gtmr_warm(c, 1);
            } else {
                gtmr_cold(c, x);
            }
            const double warmed = now_ns();
            gtmr_prepare(c, t, head[3]);
            const double prepared = now_ns();
            status = gtmr_feedback(c, x, plan);
            const double end = now_ns();
            total = fmin(total, end - start);
            least[0] = fmin(least[0], warmed - start);
            least[1] = fmin(least[1], prepared - warmed);
            least[2] = fmin(least[2], end - prepared);
        }
        warm = is_a_start(status, plan, n_x, stages, head[4]);
        const double u0 = plan[(stages + 1) * n_x];
        const double row[6] = {total, least[0], least[1], least[2], (double)status, u0};
        fwrite(row, sizeof row, 1, out);
    }
    return fclose(out) != 0;
}
