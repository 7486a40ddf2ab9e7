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
/* t, now, margin_scale, x, u, setpoints at the end of the first stage */
#define COLUMNS (3 + N_X + 2 * GTMR_ROTORS)
/* dt, p, eta, xi, u_due, overdue, age, cause, u */
#define GUARD_COLUMNS (10 + 3 * GTMR_ROTORS)
/* Hz/s, Hz */
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

static int replay_controller(FILE *file, const gtmr_parameters *problem, int is_offset_free)
{
    double row[COLUMNS], worst = 0.0;
    const double *x = row + 3, *u = x + N_X, *next_hz = u + GTMR_ROTORS;
    const double *planned = plan + (GTMR_STAGES + 1) * N_X;
    const double *setpoints_hz = plan + GTMR_SETPOINTS;
    int steps = 0, rotor;
    gtmr_controller *controller =
        gtmr_create(memory + (64 - (uintptr_t)memory % 64) % 64, problem);
    if (is_offset_free)
        gtmr_set_margins(controller, gtmr_margins[0][0], GTMR_MARGIN_ROWS);
    for (; read_row(file, row, COLUMNS); steps++) {
        if (steps == 0)
            gtmr_set_mode(controller, is_offset_free ? 0.0 : row[2], is_offset_free);
        gtmr_step(controller, row[0], x, row[1], plan);
        for (rotor = 0; rotor < GTMR_ROTORS; rotor++) {
            worst = fmax(worst, fabs(planned[rotor] - u[rotor]));
            worst = fmax(worst, fabs(setpoints_hz[GTMR_ROTORS + rotor] - next_hz[rotor]));
        }
    }
    printf("%d steps%s, largest difference of a command %g Hz/s\n", steps,
           is_offset_free ? " of offset_free" : "", worst);
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
    well = replay_controller(flight, &gtmr_problem, 0);
    well = replay_controller(offset_free, &gtmr_offset_free_problem, 1) && well;
    well = replay_guard(guarded) && well;
    fclose(flight);
    fclose(offset_free);
    fclose(guarded);
    return well ? EXIT_SUCCESS : EXIT_FAILURE;
}
