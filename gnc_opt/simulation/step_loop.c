/* Propagates X over n rows of known values, up to a step at which the unconstrained law is not valid; returns the
   number of steps.
   STEP, STATES, KNOWN and N_OUT are replaced. */
#include <stdlib.h>
#include <string.h>

CASADI_SYMBOL_EXPORT casadi_int propagate_steps(const casadi_real *X, const casadi_real *rows, const casadi_real *C,
                                                casadi_real *final, casadi_int n) {
  casadi_int n_arg, n_res, n_iw, n_w, k = 0;
  casadi_real valid = 1;
  int failed = STEP_work(&n_arg, &n_res, &n_iw, &n_w);
  const casadi_real **arg = malloc(n_arg * sizeof *arg);
  casadi_real **res = malloc((n_res + 1) * sizeof *res), *w = malloc((n_w + STATES) * sizeof *w), *now = w + n_w;
  casadi_int *iw = malloc((n_iw + 1) * sizeof *iw);
  failed = failed || !arg || !res || !w || !iw;
  if (!failed) {
    STEP_incref();
    int memory = STEP_checkout();
    memcpy(final, X, STATES * sizeof *X);
    for (; k < n && !failed && valid == 1; k++) {
      memcpy(now, final, STATES * sizeof *now);
      arg[0] = now;
      arg[1] = rows + k * KNOWN;
      arg[2] = C;
      res[0] = final;
      if (N_OUT > 1) res[1] = &valid;
      failed = STEP(arg, res, iw, w, memory);
      if (valid != 1) {
        memcpy(final, now, STATES * sizeof *now);
        k--;
      }
    }
    STEP_release(memory);
    STEP_decref();
  }
  free(arg);
  free(res);
  free(w);
  free(iw);
  return failed ? -1 : k;
}
