void @prefix@_signal(double t, real_t *r)
{
    const double place = floor((t - @upper@_T0) / @upper@_DT + 1e-6);
    long row = 0;
    /* written so that a time which is not a number takes the first row */
    if (place >= @upper@_N_ROWS - 1)
        row = @upper@_N_ROWS - 1;
    else if (place > 0)
        row = (long)place;
    look_up(row, r);
}

void @prefix@_start(double t, const real_t *x, real_t *z)
{
    real_t r[@signals@];
    @prefix@_signal(t, r);
    start(@time@, x, r, z);
}

void @prefix@_step(double t, const real_t *x, real_t *z, real_t *u)
{
    real_t r[@signals@];
    real_t z_next[@memory@];
    int i;
    @prefix@_signal(t, r);
    step(@time@, x, r, z, u, z_next);
    for (i = 0; i < @upper@_N_MEMORY; ++i)
        z[i] = z_next[i];
}
