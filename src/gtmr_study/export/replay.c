// Copyright 2026 the gtmr authors
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

/* Replays flight.csv and compares the commands with those that were recorded in it. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "gtmr.h"
#include "parameters.h"

#define N_X (12 + GTMR_ROTORS)
#define COLUMNS (2 + N_X + GTMR_ROTORS)
/* Hz/s */
#define TOLERANCE 1e-9

static unsigned char memory[GTMR_MEMORY_BYTES + 64];
static double plan[GTMR_PLAN_LENGTH];

static int read_row(FILE *file, double *row)
{
    int column;
    for (column = 0; column < COLUMNS; column++)
        if (fscanf(file, column == 0 ? "%lf" : ",%lf", &row[column]) != 1)
            return 0;
    return 1;
}

int main(int argc, char **argv)
{
    /* t, margin_scale, x, u */
    double row[COLUMNS], worst = 0.0;
    const double *x = row + 2, *u = x + N_X;
    int steps = 0, rotor;
    gtmr_controller *controller;
    FILE *file = argc == 2 ? fopen(argv[1], "r") : NULL;

    if (file == NULL) {
        fprintf(stderr, "usage: replay flight.csv\n");
        return 2;
    }
    if (gtmr_size() > GTMR_MEMORY_BYTES) {
        fprintf(stderr, "GTMR_MEMORY_BYTES: at least %lu\n", (unsigned long)gtmr_size());
        return 2;
    }
    controller = gtmr_create(memory + (64 - (uintptr_t)memory % 64) % 64, &gtmr_problem);
    for (; read_row(file, row); steps++) {
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
    fclose(file);
    printf("%d steps, largest difference of a command %g Hz/s\n", steps, worst);
    return steps > 0 && worst <= TOLERANCE ? EXIT_SUCCESS : EXIT_FAILURE;
}
