// The closed loop of peers/mpc.py: a real-time iteration by generated C and DAQP, then the plant.
//
// `generated.c` has two functions: `condensed` (plan, start, reference -> the quadratic program and
// the linearised stages) and `plant`. Nothing is allocated after the first period begins.
#include "api.h"
#include "generated.h"
#include "utils.h"
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum {
    N = HORIZON,
    INPUTS = 3 * N,
    WHEELS = 4 * N,
    VELOCITIES = 3 * N,
    ROWS = WHEELS + VELOCITIES,
    LIMITS = INPUTS + ROWS, // inputs, wheels, velocities, in this order
};

// The plan that the next period is linearised about.
static double plan_states[N][6], plan_inputs[N][3];
// The quadratic program; matrices row by row.
static double hessian[INPUTS * INPUTS], slope[INPUTS], rows[ROWS * INPUTS];
static double lower[LIMITS], upper[LIMITS], solution[INPUTS];
static int active[LIMITS];
static DAQPProblem program = {
    .n = INPUTS, .m = LIMITS, .ms = INPUTS, .H = hessian, .f = slope, .A = rows,
    .bupper = upper, .blower = lower, .sense = active,
};
static DAQPWorkspace work;
// x+ = A x + B u + c of every stage; matrices column by column.
static double by_state[N][6][6], by_input[N][3][6], offset[N][6];
// Scratch of the generated functions.
static const double **arguments;
static double **results, *reals;
static casadi_int *integers;

static double micros(struct timespec from, struct timespec to) {
    return 1e6 * (double)(to.tv_sec - from.tv_sec) + 1e-3 * (double)(to.tv_nsec - from.tv_nsec);
}

// Linearises about the plan and eliminates the states.
static void condense(const double *state, const double *reference) {
    const double *in[] = {plan_states[0], plan_inputs[0], state, reference};
    double *out[] = {
        hessian, slope, rows + WHEELS * INPUTS, lower + INPUTS + WHEELS, upper + INPUTS + WHEELS,
        by_state[0][0], by_input[0][0], offset[0],
    };
    memcpy(arguments, in, sizeof in);
    memcpy(results, out, sizeof out);
    condensed(arguments, results, integers, reals, 0);
}

// The last active set, each constraint one stage earlier. The last stage keeps its own.
static void shift_active_set(void) {
    static const int first[] = {0, INPUTS, INPUTS + WHEELS}, width[] = {3, 4, 3};
    for (int kind = 0; kind < 3; kind++) {
        size_t all = (size_t)N * width[kind], stage = (size_t)width[kind];
        int *to = active + first[kind], *from = work.sense + first[kind];
        memcpy(to, from + stage, (all - stage) * sizeof *to);
        memcpy(to + all - stage, from + all - stage, stage * sizeof *to);
    }
}

// Solves the program; DAQP's exit flag, negative where there is no solution.
//
// DAQP_UPDATE_unconstrained: where no limit binds, DAQP returns the unconstrained optimum and
// does not transform the rows.
static int solve(void) {
    DAQPResult result = {.x = solution};
    int changed = DAQP_UPDATE_Rinv | DAQP_UPDATE_M | DAQP_UPDATE_v | DAQP_UPDATE_d
        | DAQP_UPDATE_sense | DAQP_UPDATE_unconstrained;
    shift_active_set();
    int flag = daqp_update_ldp(changed, &work, &program);
    if (flag < 0) return flag;
    daqp_solve(&result, &work);
    return result.exitflag;
}

// States of the plan from the solution, and its inputs moved by one stage.
static void predict(const double *state) {
    for (int k = 0; k < N; k++) {
        double after[6];
        memcpy(after, offset[k], sizeof after);
        const double *input = solution + 3 * k;
        for (int column = 0; column < 6; column++)
            for (int row = 0; row < 6; row++)
                after[row] += by_state[k][column][row] * state[column];
        for (int column = 0; column < 3; column++)
            for (int row = 0; row < 6; row++)
                after[row] += by_input[k][column][row] * input[column];
        state = memcpy(plan_states[k], after, sizeof after);
        memcpy(plan_inputs[k], solution + 3 * (k + 1 < N ? k + 1 : k), sizeof plan_inputs[k]);
    }
}

// One period. times: all of it, linearise and condense, quadratic program, predict [us].
static int iterate(const double *state, const double *reference, double *times) {
    struct timespec begin, written, solved, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    condense(state, reference);
    clock_gettime(CLOCK_MONOTONIC, &written);
    int flag = solve();
    clock_gettime(CLOCK_MONOTONIC, &solved);
    predict(state);
    clock_gettime(CLOCK_MONOTONIC, &end);
    times[0] = micros(begin, end);
    times[1] = micros(begin, written);
    times[2] = micros(written, solved);
    times[3] = micros(solved, end);
    return flag;
}

static casadi_int larger(casadi_int a, casadi_int b) { return a > b ? a : b; }

// Memory, constant rows and limits, and a plan on the reference. Negative where DAQP fails.
static int set_up(const double *reference, const double *limits, const double *wheels) {
    casadi_int a[2], r[2], i[2], w[2];
    condensed_work(&a[0], &r[0], &i[0], &w[0]);
    plant_work(&a[1], &r[1], &i[1], &w[1]);
    arguments = calloc((size_t)larger(a[0], a[1]), sizeof *arguments);
    results = calloc((size_t)larger(r[0], r[1]), sizeof *results);
    integers = calloc((size_t)larger(i[0], i[1]) + 1, sizeof *integers);
    reals = calloc((size_t)larger(w[0], w[1]) + 1, sizeof *reals);
    for (int row = 0; row < LIMITS; row++) {
        upper[row] = row < INPUTS + WHEELS ? limits[row] : DAQP_INF;
        lower[row] = -upper[row];
    }
    memcpy(rows, wheels, WHEELS * INPUTS * sizeof *rows);
    for (int k = 0; k < N; k++) {
        memcpy(plan_states[k], reference + 6 * k, sizeof plan_states[k]);
        memcpy(plan_inputs[k], reference + 6 * k + 3, sizeof plan_inputs[k]);
    }
    // DAQP is set up with a program of the problem, not with zeros.
    condense(reference, reference);
    return setup_daqp(&program, &work, NULL);
}

// Drives so many periods. Returns 0, or 1 + the period that has no solution.
int drive(int periods, const double *reference, const double *pushes, const double *limits,
          const double *wheels, double *states, double *inputs, double *times) {
    if (set_up(reference, limits, wheels) < 0) return 1;
    double x[6];
    memcpy(x, reference, sizeof x);
    for (int k = 0; k < periods; k++) {
        double *u = inputs + 3 * k, after[6];
        for (int i = 0; i < 6; i++) x[i] += pushes[6 * k + i];
        memcpy(states + 6 * k, x, sizeof x);
        if (iterate(x, reference + 6 * k, times + 4 * k) <= 0) return k + 1;
        for (int i = 0; i < 3; i++) {
            double limited = solution[i] < limits[i] ? solution[i] : limits[i];
            u[i] = limited > -limits[i] ? limited : -limits[i];
        }
        arguments[0] = x;
        arguments[1] = u;
        results[0] = after;
        plant(arguments, results, integers, reals, 0);
        memcpy(x, after, sizeof x);
    }
    return 0;
}
