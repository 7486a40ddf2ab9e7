// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Replays flight.csv with the controller and guard.csv with the guard, and compares the commands
 * with those that were recorded in them. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "gtmr.h"
#include "guard_parameters.h"
#include "parameters.h"

#define N_X (12 + GTMR_ROTORS)
#define N_THETA 9
#define PI 3.14159265358979323846
/* t, margin_scale, x, u */
#define COLUMNS (2 + N_X + GTMR_ROTORS)
/* dt, p, eta, xi, u_due, overdue, age, cause, u */
#define GUARD_COLUMNS (10 + 3 * GTMR_ROTORS)
/* Hz/s */
#define TOLERANCE 1e-9
/* The guard amplifies rounding by its filters, and compilers may fuse operations. */
#define GUARD_TOLERANCE 1e-6

static unsigned char memory[GTMR_MEMORY_BYTES + 64];
static double plan[GTMR_PLAN_LENGTH];
static gtmr_guard guard;

static int read_row(FILE *file, double *row, int columns)
{
    int column;
    for (column = 0; column < columns; column++)
        if (fscanf(file, column == 0 ? "%lf" : ",%lf", &row[column]) != 1)
            return 0;
    return 1;
}

static int replay_controller(FILE *file)
{
    double row[COLUMNS], worst = 0.0;
    const double *x = row + 2, *u = x + N_X;
    int steps = 0, rotor;
    gtmr_controller *controller =
        gtmr_create(memory + (64 - (uintptr_t)memory % 64) % 64, &gtmr_problem);
    for (; read_row(file, row, COLUMNS); steps++) {
        if (steps == 0)
            gtmr_cold(controller, x);
        else
            gtmr_warm(controller, 1);
        gtmr_prepare(controller, row[0], row[1]);
        gtmr_feedback(controller, x, plan);
        for (rotor = 0; rotor < GTMR_ROTORS; rotor++) {
            const double *planned = plan + (GTMR_STAGES + 1) * N_X;
            worst = fmax(worst, fabs(planned[rotor] - u[rotor]));
        }
    }
    printf("%d steps, largest difference of a command %g Hz/s\n", steps, worst);
    return steps > 0 && worst <= TOLERANCE;
}

/* The mode offset_free: disturbances that were estimated act in the model one step later. */
static int replay_offset_free(FILE *file)
{
    double row[COLUMNS], estimate[N_X + N_THETA], theta[N_THETA] = {0.0}, worst = 0.0, last_t = 0.0;
    const double *x = row + 2, *u = x + N_X;
    int steps = 0, j;
    gtmr_controller *controller =
        gtmr_create(memory + (64 - (uintptr_t)memory % 64) % 64, &gtmr_offset_free_problem);
    for (; read_row(file, row, COLUMNS); steps++) {
        const int seen = steps > 0 ? steps - 1 : 0;
        gtmr_disturb(controller, theta);
        if (steps == 0)
            gtmr_cold(controller, x);
        else
            gtmr_warm(controller, 1);
        gtmr_prepare(controller, row[0], 0.0);
        gtmr_tighten(controller,
                     gtmr_margins[seen < GTMR_MARGIN_ROWS ? seen : GTMR_MARGIN_ROWS - 1]);
        gtmr_observe(controller, x, steps > 0 ? row[0] - last_t : 0.0, estimate);
        estimate[5] += 2.0 * PI * round((x[5] - estimate[5]) / (2.0 * PI));
        gtmr_feedback(controller, estimate, plan);
        for (j = 0; j < N_THETA; j++)
            theta[j] = estimate[N_X + j];
        for (j = 3; j < 6; j++)
            theta[j] *= gtmr_offset_free_problem.gust_decay;
        for (j = 0; j < GTMR_ROTORS; j++)
            worst = fmax(worst, fabs(plan[(GTMR_STAGES + 1) * N_X + j] - u[j]));
        last_t = row[0];
    }
    printf("%d steps of offset_free, largest difference of a command %g Hz/s\n", steps, worst);
    return steps > 0 && worst <= TOLERANCE;
}

static int replay_guard(FILE *file)
{
    double row[GUARD_COLUMNS], command[GTMR_ROTORS], worst = 0.0;
    const double *u_due = row + 7 + GTMR_ROTORS, *times = u_due + GTMR_ROTORS, *u = times + 3;
    int steps = 0, in_charge = 0, alike = 1, rotor;
    gtmr_guard_configure(&guard, &gtmr_guard_numbers);
    gtmr_guard_reset(&guard);
    for (; read_row(file, row, GUARD_COLUMNS); steps++) {
        gtmr_guard_cause cause = gtmr_guard_step(&guard, row[0], row + 1, row + 4, row + 7, u_due,
                                                 times[0], times[1], command);
        alike = alike && cause == (gtmr_guard_cause)times[2];
        in_charge += cause != GTMR_GUARD_NONE;
        for (rotor = 0; rotor < GTMR_ROTORS; rotor++)
            worst = fmax(worst, fabs(command[rotor] - u[rotor]));
    }
    printf("%d steps of the guard, %d in charge, largest difference of a command %g Hz/s\n",
           steps, in_charge, worst);
    return in_charge > 0 && alike && worst <= GUARD_TOLERANCE;
}

int main(int argc, char **argv)
{
    FILE *flight = argc == 4 ? fopen(argv[1], "r") : NULL;
    FILE *offset_free = argc == 4 ? fopen(argv[2], "r") : NULL;
    FILE *guarded = argc == 4 ? fopen(argv[3], "r") : NULL;
    int well;

    if (flight == NULL || offset_free == NULL || guarded == NULL) {
        fprintf(stderr, "usage: replay flight.csv offset_free.csv guard.csv\n");
        return 2;
    }
    if (gtmr_size() > GTMR_MEMORY_BYTES) {
        fprintf(stderr, "GTMR_MEMORY_BYTES: at least %lu\n", (unsigned long)gtmr_size());
        return 2;
    }
    well = replay_controller(flight);
    well = replay_offset_free(offset_free) && well;
    well = replay_guard(guarded) && well;
    fclose(flight);
    fclose(offset_free);
    fclose(guarded);
    return well ? EXIT_SUCCESS : EXIT_FAILURE;
}
