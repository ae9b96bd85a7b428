/* The quadratic programme of a horizon, condensed: least |y|^2 / 2 within limits of every step.
 *
 * y holds, step by step, omega (N_U) and the slacks of the softly limited states, each shifted by the root of its
 * price (N_S). Products with the matrix of the rows and with its transpose are sweeps forward and backward along the
 * horizon; the matrix itself is nowhere. Dual active-set method with a factorisation L D L' of the products of the
 * active rows, which is changed row by row (D. Arnstrom, A. Bemporad, D. Axehill, A dual active-set solver for embedded
 * quadratic programming using recursive LDL' updates, IEEE Trans. Automatic Control 67 (2022) 4362-4369). All arrays
 * have a fixed size; MOST bounds the number of iterations.
 *
 * Rows of a step: commands, changes of commands, lower and upper limits of states, slacks; scaled to [-1, 1].
 */
#define N_Y (N_U + N_S)
#define N_ROWS_OF_STEP (N_U + RATES * N_U + 2 * N_L + N_S)
#define SIZE (HORIZON * N_Y)
#define ROWS (HORIZON * N_ROWS_OF_STEP)
#define FACTOR ((SIZE + 1) * (SIZE + 2) / 2)

/* What the rows depend on beside y. */
typedef struct {
    long first;
    const real_t *e, *before;
} situation;

typedef struct {
    int count;
    int row[SIZE + 1];
    real_t side[SIZE + 1]; /* 1 at a lower limit, -1 at an upper one */
    real_t mu[SIZE + 1]; /* multipliers, positive at lower limits */
    real_t square[SIZE + 1]; /* of each row */
    real_t l[FACTOR], d[SIZE + 1]; /* lower triangle by rows, the ones on its diagonal left out */
} active_set;

static real_t *factor_row(active_set *set, int i) { return &set->l[i * (i + 1) / 2]; }

static real_t magnitude(real_t a) { return a < 0 ? -a : a; }

/* c = M y + c0; of the linear part alone if there is no situation but its first row. */
static void rows_of(const situation *at, int affine, const real_t *y, real_t *c)
{
    real_t e[N_E], next[N_E], u[N_U], last[N_U];
    int i, j, k;
    for (i = 0; i < N_E; ++i)
        e[i] = affine ? at->e[i] : 0;
    for (i = 0; i < N_U; ++i)
        last[i] = affine ? at->before[i] : 0;
    for (j = 0; j < HORIZON; ++j) {
        const matrices *m = matrices_of(at->first, j);
        const real_t *omega = &y[j * N_Y], *reference = row_of(at->first + j + 1);
        const real_t *feedforward = row_of(at->first + j) + N_X;
        for (i = 0; i < N_U; ++i) {
            u[i] = affine ? feedforward[i] : 0;
            for (k = 0; k < N_E; ++k)
                u[i] -= m->k[i][k] * e[k];
            for (k = 0; k < N_U; ++k)
                u[i] += m->g[i][k] * omega[k];
        }
        for (i = 0; i < N_E; ++i) {
            next[i] = 0;
            for (k = 0; k < N_E; ++k)
                next[i] += m->a[i][k] * e[k];
            for (k = 0; k < N_U; ++k)
                next[i] += m->f[i][k] * omega[k];
        }
        for (i = 0; i < N_E; ++i)
            e[i] = next[i];
        for (i = 0; i < N_U; ++i)
            *c++ = (u[i] - (affine ? command_middle[i] : 0)) * command_scale[i];
        for (i = 0; i < RATES * N_U; ++i)
            *c++ = (u[i] - last[i]) * rate_scale[i];
        for (i = 0; i < N_U; ++i)
            last[i] = u[i];
        for (k = -1; k <= 1; k += 2)
            for (i = 0; i < N_L; ++i) {
                *c = e[limited_error[i]] * state_scale[i];
                if (affine)
                    *c -= ((k < 0 ? state_lower[i] : state_upper[i]) - reference[limited_state[i]]) * state_scale[i];
                if (limited_slack[i] >= 0)
                    *c -= (real_t)k * (omega[N_U + limited_slack[i]] / slack_root[limited_slack[i]] - (affine ? 1 : 0));
                ++c;
            }
        for (i = 0; i < N_S; ++i)
            *c++ = omega[N_U + i] - (affine ? slack_root[i] : 0);
    }
}

/* y = M' lambda */
static void transposed(long first, const real_t *lambda, real_t *y)
{
    real_t p[N_E], next[N_E], by_command[N_U], later[N_U];
    int i, j, k;
    for (i = 0; i < N_E; ++i)
        p[i] = 0;
    for (i = 0; i < N_U; ++i)
        later[i] = 0;
    for (j = HORIZON - 1; j >= 0; --j) {
        const matrices *m = matrices_of(first, j);
        const real_t *of_states = &lambda[j * N_ROWS_OF_STEP + N_U + RATES * N_U], *of_slacks = of_states + 2 * N_L;
        real_t *out = &y[j * N_Y];
        for (i = 0; i < N_S; ++i)
            out[N_U + i] = of_slacks[i];
        for (i = 0; i < N_L; ++i) {
            p[limited_error[i]] += (of_states[i] + of_states[N_L + i]) * state_scale[i];
            if (limited_slack[i] >= 0)
                out[N_U + limited_slack[i]] += (of_states[i] - of_states[N_L + i]) / slack_root[limited_slack[i]];
        }
        for (i = 0; i < N_U; ++i) {
            const real_t change = RATES ? lambda[j * N_ROWS_OF_STEP + RATES * N_U + i] * rate_scale[i] : 0;
            by_command[i] = lambda[j * N_ROWS_OF_STEP + i] * command_scale[i] + change - later[i];
            later[i] = change;
        }
        for (i = 0; i < N_U; ++i) {
            out[i] = 0;
            for (k = 0; k < N_E; ++k)
                out[i] += m->f[k][i] * p[k];
            for (k = 0; k < N_U; ++k)
                out[i] += m->g[k][i] * by_command[k];
        }
        for (i = 0; i < N_E; ++i) {
            next[i] = 0;
            for (k = 0; k < N_E; ++k)
                next[i] += m->a[k][i] * p[k];
            for (k = 0; k < N_U; ++k)
                next[i] -= m->k[k][i] * by_command[k];
        }
        for (i = 0; i < N_E; ++i)
            p[i] = next[i];
    }
}

static void add_row(active_set *set, long first, int row, real_t side)
{
    real_t lambda[ROWS], y[SIZE], c[ROWS], *l;
    const situation at = {first, 0, 0};
    int i, k;
    const int n = set->count;
    for (i = 0; i < ROWS; ++i)
        lambda[i] = 0;
    lambda[row] = 1;
    transposed(first, lambda, y);
    rows_of(&at, 0, y, c);
    l = factor_row(set, n);
    set->d[n] = c[row];
    for (i = 0; i < n; ++i) {
        const real_t *other = factor_row(set, i);
        l[i] = c[set->row[i]];
        for (k = 0; k < i; ++k)
            l[i] -= other[k] * l[k];
    }
    for (i = 0; i < n; ++i) {
        const real_t scaled = l[i] / set->d[i];
        set->d[n] -= scaled * l[i];
        l[i] = scaled;
    }
    set->square[n] = c[row];
    if (set->d[n] <= DEPENDENT * c[row])
        set->d[n] = 0;
    set->row[n] = row;
    set->side[n] = side;
    set->mu[n] = 0;
    set->count = n + 1;
}

/* Take the row in the place r away: what follows it has L D L' and its column's outer product (Gill, Golub, Murray and
 * Saunders, Methods for modifying matrix factorizations, Math. Comp. 28 (1974), method C1). */
static void take_away(active_set *set, int r)
{
    real_t column[SIZE + 1], weight = set->d[r];
    int i, k;
    for (i = r + 1; i < set->count; ++i) {
        real_t *to = factor_row(set, i - 1), *from = factor_row(set, i);
        column[i - 1] = from[r];
        for (k = 0; k < r; ++k)
            to[k] = from[k];
        for (k = r + 1; k < i; ++k)
            to[k - 1] = from[k];
        set->d[i - 1] = set->d[i];
        set->square[i - 1] = set->square[i];
        set->row[i - 1] = set->row[i];
        set->side[i - 1] = set->side[i];
        set->mu[i - 1] = set->mu[i];
    }
    set->count -= 1;
    for (k = r; k < set->count; ++k) {
        const real_t p = column[k], grown = set->d[k] + weight * p * p;
        real_t share = 0;
        if (grown > 0) {
            share = weight * p / grown;
            weight *= set->d[k] / grown;
        }
        set->d[k] = grown;
        for (i = k + 1; i < set->count; ++i) {
            real_t *l = factor_row(set, i);
            column[i] -= p * l[k];
            l[k] += share * column[i];
        }
    }
    k = set->count - 1;
    if (k >= 0 && set->d[k] <= DEPENDENT * set->square[k])
        set->d[k] = 0;
}

/* The change of the multipliers that closes the gaps of the active rows; of the last row's direction alone, and 0, if
 * it depends on the others. */
static int step_of(active_set *set, const real_t *gap, real_t *step)
{
    const int n = set->count, independent = n == 0 || set->d[n - 1] > 0;
    int i, k;
    for (i = 0; i < n; ++i) {
        step[i] = independent ? gap[i] : i == n - 1 ? set->side[i] : 0;
        if (independent)
            for (k = 0; k < i; ++k)
                step[i] -= factor_row(set, i)[k] * step[k];
    }
    if (independent)
        for (i = 0; i < n; ++i)
            step[i] /= set->d[i];
    for (i = n - 1; i >= 0; --i)
        for (k = i + 1; k < n; ++k)
            step[i] -= factor_row(set, k)[i] * step[k];
    return independent;
}

/* The row that is farthest outside, -1 if none is; its side is 1 beyond a lower limit, -1 beyond an upper one. */
static int farthest(const real_t *c, real_t tolerance, real_t *side)
{
    real_t most = tolerance;
    int i, found = -1;
    for (i = 0; i < ROWS; ++i) {
        const int kind = i % N_ROWS_OF_STEP;
        if (row_lower[kind] - c[i] > most) {
            most = row_lower[kind] - c[i];
            *side = 1;
            found = i;
        }
        if (c[i] - row_upper[kind] > most) {
            most = c[i] - row_upper[kind];
            *side = -1;
            found = i;
        }
    }
    return found;
}

static real_t gap_of(const active_set *set, const real_t *c, int i)
{
    const int kind = set->row[i] % N_ROWS_OF_STEP;
    return (set->side[i] > 0 ? row_lower[kind] : row_upper[kind]) - c[set->row[i]];
}

/* The least y for this situation; 0 if there is none, or if the iterations do not suffice. */
static int least(const situation *at, real_t *y)
{
    active_set set;
    real_t lambda[ROWS], c[ROWS], gap[SIZE + 1], step[SIZE + 1];
    int i, j, iteration, settled = 1;
    set.count = 0;
    for (j = 0; j < HORIZON; ++j) /* slacks at zero, which the least |y| of its own is not at */
        for (i = 0; i < N_S; ++i) {
            add_row(&set, at->first, (j + 1) * N_ROWS_OF_STEP - N_S + i, 1);
            set.mu[set.count - 1] = slack_root[i];
        }
    for (iteration = 0; iteration < MOST; ++iteration) {
        real_t most = 0, length = 1, tolerance;
        int blocking = -1, independent;
        for (i = 0; i < ROWS; ++i)
            lambda[i] = 0;
        for (i = 0; i < set.count; ++i)
            lambda[set.row[i]] += set.mu[i];
        transposed(at->first, lambda, y);
        rows_of(at, 1, y, c);
        tolerance = 1;
        for (i = 0; i < ROWS; ++i) {
            if (!(magnitude(c[i]) < NONE))
                return 0; /* not a number, or without bounds */
            if (magnitude(c[i]) > tolerance)
                tolerance = magnitude(c[i]);
        }
        tolerance *= TOLERANCE;
        for (i = 0; i < set.count; ++i) {
            gap[i] = gap_of(&set, c, i);
            if (magnitude(gap[i]) > most)
                most = magnitude(gap[i]);
        }
        if (settled && most <= tolerance) {
            real_t side = 0;
            const int row = farthest(c, tolerance, &side);
            if (row < 0)
                return 1;
            if (set.count > SIZE)
                return 0;
            add_row(&set, at->first, row, side);
            gap[set.count - 1] = gap_of(&set, c, set.count - 1);
        }
        independent = step_of(&set, gap, step);
        for (i = 0; i < set.count; ++i) {
            const real_t toward = set.side[i] * step[i], left = set.side[i] * set.mu[i];
            if (toward < 0 && (!independent || left + toward < 0) && (blocking < 0 || -left > length * toward)) {
                length = left > 0 ? -left / toward : 0;
                blocking = i;
            }
        }
        if (!independent && blocking < 0)
            return 0; /* no y keeps all of these rows */
        for (i = 0; i < set.count; ++i)
            set.mu[i] += length * step[i];
        settled = blocking < 0;
        if (blocking >= 0)
            take_away(&set, blocking);
    }
    return 0;
}

/* What the first command adds to its feedforward: the regulator's share, and the programme's if there is a solution. */
static void programme(const real_t *row, const real_t *e, const real_t *before, real_t *v, real_t *solved)
{
    situation at;
    real_t y[SIZE];
    const matrices *m;
    int i, k, found;
    at.first = (long)row[0];
    at.e = e;
    at.before = before;
    m = matrices_of(at.first, 0);
    found = least(&at, y);
    for (i = 0; i < N_U; ++i) {
        v[i] = 0;
        for (k = 0; k < N_E; ++k)
            v[i] -= m->k[i][k] * e[k];
        if (found)
            for (k = 0; k < N_U; ++k)
                v[i] += m->g[i][k] * y[k];
    }
    solved[0] = (real_t)found;
}
