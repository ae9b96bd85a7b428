/* Test driver: reads lines of a time and a state, writes the commands of successive steps.
 * With an argument it runs a built-in case instead: three steps with all states at 0.1. */
#include <stdio.h>

#include "lqr_ekf.h"

static int read_line(double *t, double *x)
{
    int i;
    if (scanf("%lf", t) != 1)
        return 0;
    for (i = 0; i < LQR_EKF_N_STATES; ++i)
        if (scanf("%lf", &x[i]) != 1)
            return 0;
    return 1;
}

static void run(double t, const double *x, double *z, int *begun)
{
    double u[LQR_EKF_N_COMMANDS];
    int i;
    if (!*begun)
        lqr_ekf_start(t, x, z);
    *begun = 1;
    lqr_ekf_step(t, x, z, u);
    for (i = 0; i < LQR_EKF_N_COMMANDS; ++i)
        printf("%.17g%s", (double)u[i], i + 1 < LQR_EKF_N_COMMANDS ? " " : "\n");
}

int main(int argc, char **argv)
{
    double x[LQR_EKF_N_STATES];
    double z[34] = {0.0};
    double t = LQR_EKF_T0;
    int begun = 0, k;
    (void)argv;
    if (argc > 1) {
        for (k = 0; k < LQR_EKF_N_STATES; ++k)
            x[k] = 0.1;
        for (k = 0; k < 3; ++k)
            run(LQR_EKF_T0 + k * LQR_EKF_DT, x, z, &begun);
        return 0;
    }
    while (read_line(&t, x))
        run(t, x, z, &begun);
    return 0;
}
