"""The rendezvous in plain arithmetic, for every program alike, and how each is timed.

Equation as printed in Mousavi & Esmailifar, J. Space Sci. Technol. & Appl. 1(2), 147-166, 2022. SI units.
"""

import json
import math
import sys
import time

INITIAL_POSITIONS = {1: (20, 0, 0), 2: (20, 4, 0), 3: (20, 4, 4), 4: (20, 4, -5), 5: (25, -5, -5)}
FINAL_POSITION = (0, 0, -10)
FINAL_SIGMA = (0.0, math.tan(math.pi / 8), 0.0)
LIMITS = (50.0, 50.0, 50.0, 320.0, 320.0, 320.0)
INERTIA = (5621.0, 4547.0, 2364.0)
MASS = 3200.0
ORBIT_RATE = math.sqrt(398600.4418e9 / (6378.137e3 + 580e3) ** 3)
LONGEST = 100.0
GUESSED = 50.5
"""Final time to start from (s): the middle of what it may be."""
SCALES = (*(0.05,) * 3, *(1.0,) * 3, *(2.0,) * 3, *(20.0,) * 3)
"""Typical sizes of the states."""
LONG_S = 20.0
"""A way that has taken so long in all (s) is not run again: it leads no column, and others wait."""


def ends(case):
    """Return the initial and the final state."""
    first = [0.0] * 9 + [float(v) for v in INITIAL_POSITIONS[case]]
    last = [0.0] * 3 + list(FINAL_SIGMA) + [0.0] * 3 + [float(v) for v in FINAL_POSITION]
    return first, last


def line(case, share):
    """Return the state on the straight line between the ends."""
    first, last = ends(case)
    return [a + share * (b - a) for a, b in zip(first, last, strict=True)]


def rates(x, u):
    """Return the twelve rates of x = (omega, sigma, v, r) under u = (torque, force)."""
    (o1, o2, o3), (s1, s2, s3), (v1, v2, v3), (_, y, z) = x[0:3], x[3:6], x[6:9], x[9:12]
    n = s1 * s1 + s2 * s2 + s3 * s3
    d = (1 + n) * (1 + n)
    k = 1 - n
    m = (
        (1 - 8 * (s2 * s2 + s3 * s3) / d, (8 * s1 * s2 + 4 * k * s3) / d, (8 * s1 * s3 - 4 * k * s2) / d),
        ((8 * s1 * s2 - 4 * k * s3) / d, 1 - 8 * (s1 * s1 + s3 * s3) / d, (8 * s2 * s3 + 4 * k * s1) / d),
        ((8 * s1 * s3 + 4 * k * s2) / d, (8 * s2 * s3 - 4 * k * s1) / d, 1 - 8 * (s1 * s1 + s2 * s2) / d),
    )
    w = [-ORBIT_RATE * row[1] for row in m]
    i1, i2, i3 = INERTIA
    h = (i1 * o1, i2 * o2, i3 * o3)
    g = (i1 * (o1 + w[0]), i2 * (o2 + w[1]), i3 * (o3 + w[2]))
    turning = (
        (u[0] - (o2 * h[2] - o3 * h[1]) - (w[1] * g[2] - w[2] * g[1])) / i1,
        (u[1] - (o3 * h[0] - o1 * h[2]) - (w[2] * g[0] - w[0] * g[2])) / i2,
        (u[2] - (o1 * h[1] - o2 * h[0]) - (w[0] * g[1] - w[1] * g[0])) / i3,
    )
    so = 2 * (s1 * o1 + s2 * o2 + s3 * o3)
    attitude = (
        0.25 * (k * o1 + 2 * (s2 * o3 - s3 * o2) + so * s1),
        0.25 * (k * o2 + 2 * (s3 * o1 - s1 * o3) + so * s2),
        0.25 * (k * o3 + 2 * (s1 * o2 - s2 * o1) + so * s3),
    )
    push = [(m[0][i] * u[3] + m[1][i] * u[4] + m[2][i] * u[5]) / MASS for i in range(3)]
    moving = (
        push[0] + 2 * ORBIT_RATE * v3,
        push[1] - ORBIT_RATE * ORBIT_RATE * y,
        push[2] - 2 * ORBIT_RATE * v1 + 3 * ORBIT_RATE * ORBIT_RATE * z,
    )
    return (*turning, *attitude, *moving, v1, v2, v3)


def report(ways):
    """Solve what the command line names, ``CASE RUNS``, in every way; print one line of JSON each.

    Parameters
    ----------
    ways : dict
        Functions of the case that state and solve the problem and return the final time (s), by name.
    """
    case, runs = int(sys.argv[1]), int(sys.argv[2])
    for name, solve in ways.items():
        try:
            results = _timed(solve, case, runs)
        except Exception as error:  # whatever a program raises, the others go on
            results = {"failed": f"{type(error).__name__}: {error}"[:200]}
        print(json.dumps({"way": name, **results}), flush=True)


def _timed(solve, case, runs):
    """Return the final time (s) and the processor time of each run, fewer than asked for if they take long."""
    seconds = []
    while len(seconds) < runs and sum(seconds) < LONG_S:
        begin = time.process_time()
        found = float(solve(case))
        seconds.append(time.process_time() - begin)
    return {"final_time": found, "seconds": seconds}
