/* LQR_EKF: discrete-time control law, written by gnc_opt. */
#ifndef LQR_EKF_H
#define LQR_EKF_H

#define LQR_EKF_N_STATES 2
#define LQR_EKF_N_COMMANDS 2
#define LQR_EKF_N_SIGNALS 6
#define LQR_EKF_N_MEMORY 34
#define LQR_EKF_N_ROWS 1
#define LQR_EKF_DT 0.5 /* control step, s */
#define LQR_EKF_T0 0.0 /* time of the first row of the schedule, s */

/* Of a step, the same at every step, whatever the data; no memory is allocated. */
#define LQR_EKF_OPERATIONS 690 /* arithmetic, comparisons, calls */
#define LQR_EKF_STACK 912 /* bytes of the arrays on the stack, at most */
#define LQR_EKF_TABLE 48 /* bytes of the schedule */

/* Contents of the arrays, with units:
 * x (states, measured): 2
 *   [0] range, m
 *   [1] bearing, rad
 * u (commands): 2
 *   [0] F[0], N
 *   [1] F[1], N
 * r (schedule): 6
 *   [0] r_ref[0], m
 *   [1] r_ref[1], m
 *   [2] v_ref[0], m/s
 *   [3] v_ref[1], m/s
 *   [4] F_ff[0], N
 *   [5] F_ff[1], N
 * z (memory): 34
 *   [0] r_hat[0], m
 *   [1] r_hat[1], m
 *   [2] v_hat[0], m/s
 *   [3] v_hat[1], m/s
 *   [4] bearing_bias_hat, rad
 *   [5] covariance[0], -
 *   [6] covariance[1], -
 *   [7] covariance[2], -
 *   [8] covariance[3], -
 *   [9] covariance[4], -
 *   [10] covariance[5], -
 *   [11] covariance[6], -
 *   [12] covariance[7], -
 *   [13] covariance[8], -
 *   [14] covariance[9], -
 *   [15] covariance[10], -
 *   [16] covariance[11], -
 *   [17] covariance[12], -
 *   [18] covariance[13], -
 *   [19] covariance[14], -
 *   [20] range_nis, -
 *   [21] range_taken, -
 *   [22] range_refused, -
 *   [23] bearing_nis, -
 *   [24] bearing_taken, -
 *   [25] bearing_refused, -
 *   [26] bearing_next, -
 *   [27] lost_steps, -
 *   [28] last_good_r[0], m
 *   [29] last_good_r[1], m
 *   [30] last_good_v[0], m/s
 *   [31] last_good_v[1], m/s
 *   [32] lost, -
 *   [33] invalid, -
 * alarms (not 0: guarantees lost): invalid, entries of z
 */

/* Arrays of no entries may be passed as null pointers. */
/* Look up the row r of the schedule for the control step that t (s) lies in. */
void lqr_ekf_signal(double t, double *r);
/* Set the memory z from the first measurement x at t (s). */
void lqr_ekf_start(double t, const double *x, double *z);
/* Return the command u for the control step that begins at t (s), and update the memory z. */
void lqr_ekf_step(double t, const double *x, double *z, double *u);

#endif
