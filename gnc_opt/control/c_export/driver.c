/* Test driver: reads lines of a time and a state, writes the commands of successive steps.
 * With an argument it runs a built-in case instead: three steps with all states at 0.1. */
#include <stdio.h>

#include "@prefix@.h"

static int read_line(double *t, real_t *x)
{
    int i;
    if (scanf("%lf", t) != 1)
        return 0;
    for (i = 0; i < @upper@_N_STATES; ++i)
        if (scanf("@format@", &x[i]) != 1)
            return 0;
    return 1;
}

static void run(double t, const real_t *x, real_t *z, int *begun)
{
    real_t u[@upper@_N_COMMANDS];
    int i;
    if (!*begun)
        @prefix@_start(t, x, z);
    *begun = 1;
    @prefix@_step(t, x, z, u);
    for (i = 0; i < @upper@_N_COMMANDS; ++i)
        printf("%.17g%s", (double)u[i], i + 1 < @upper@_N_COMMANDS ? " " : "\n");
}

int main(int argc, char **argv)
{
    real_t x[@upper@_N_STATES];
    real_t z[@memory@] = {@zero@};
    double t = @upper@_T0;
    int begun = 0, k;
    (void)argv;
    if (argc > 1) {
        for (k = 0; k < @upper@_N_STATES; ++k)
            x[k] = @tenth@;
        for (k = 0; k < 3; ++k)
            run(@upper@_T0 + k * @upper@_DT, x, z, &begun);
        return 0;
    }
    while (read_line(&t, x))
        run(t, x, z, &begun);
    return 0;
}
