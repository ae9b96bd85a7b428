"""What is known of the published slews: converged numbers, and what the publication prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Law: TypeAlias = Literal["FLC", "LQR"]


@dataclass(frozen=True)
class Converged:
    """Numbers of one slew, computed independently at a relative tolerance of 1e-10, and the printed EULERINT.

    Attributes
    ----------
    printed : float
        EULERINT of the publication, deg s.
    eulerint : float
        deg s.
    effort, energy, work : float
        Integrals of sum |T| (N m s), sum T^2 (N^2 m^2 s) and sum |P| (J).
    peak_speed : float
        rpm.
    settling_time : float
        To 2 % of the first angle, s.
    """

    printed: float
    eulerint: float
    effort: float
    energy: float
    work: float
    peak_speed: float
    settling_time: float


CONVERGED: dict[tuple[int, Law], Converged] = {
    (1, "FLC"): Converged(458.63, 454.58, 0.7020, 0.01318, 88.45, 3129, 33.9),
    (1, "LQR"): Converged(496.44, 494.23, 0.6566, 0.02128, 82.24, 3025, 33.3),
    (2, "FLC"): Converged(804.67, 808.09, 1.0373, 0.03170, 218.19, 4690, 34.7),
    (2, "LQR"): Converged(940.54, 940.42, 0.8680, 0.03700, 158.83, 4018, 35.1),
    (3, "FLC"): Converged(768.29, 761.33, 1.1977, 0.03181, 218.14, 5425, 34.6),
    (3, "LQR"): Converged(883.80, 879.87, 0.9873, 0.03761, 163.44, 4696, 34.8),
    (4, "FLC"): Converged(71.33, 77.48, 0.1378, 0.000451, 2.988, 632, 33.5),
    (4, "LQR"): Converged(78.85, 81.64, 0.1354, 0.000830, 3.100, 644, 32.3),
    (5, "FLC"): Converged(57.42, 56.35, 0.1026, 0.000263, 1.739, 445, 33.5),
    (5, "LQR"): Converged(59.84, 59.59, 0.0997, 0.000462, 1.780, 452, 32.2),
    (6, "FLC"): Converged(372.47, 368.33, 0.6024, 0.00633, 42.28, 1613, 33.7),
    (6, "LQR"): Converged(392.26, 390.80, 0.5884, 0.01314, 43.89, 1632, 33.3),
}
INTEGRAL_TOLERANCE = 1e-3
"""Of the integrals, relative, beside half a unit of the last digit given."""
SETTLING_TOLERANCE, SPEED_TOLERANCE = 0.1, 1.0
"""s and rpm."""

LAST_DIGIT = {"energy": 0.5e-6, "effort": 0.5e-4, "work": 0.5e-3, "eulerint": 0.5e-2}
"""Half a unit of the last digit of the smallest numbers above."""


@dataclass(frozen=True)
class Peaks:
    """Largest values in the first manoeuvre, and what is left after 60 s.

    Attributes
    ----------
    rates, torques : tuple of 3 floats
        Of the body, deg/s and N m.
    wheel_torque : float
        N m.
    angle_left, speed_left : float
        deg and rpm.
    """

    rates: tuple[float, float, float]
    torques: tuple[float, float, float]
    wheel_torque: float
    angle_left: float
    speed_left: float


PEAKS: dict[Law, Peaks] = {
    "FLC": Peaks((0.659, 2.775, 2.647), (0.0178, 0.0751, 0.0537), 0.0635, 0.034, 5.0),
    "LQR": Peaks((0.644, 2.635, 2.638), (0.0334, 0.1408, 0.1343), 0.1336, 0.032, 3.2),
}

PRINTED_TOLERANCE: dict[tuple[int, Law], float] = {
    **{(m, "LQR"): 0.005 for m in (1, 2, 3, 5, 6)},
    **{(m, "FLC"): 0.02 for m in (1, 2, 3, 5, 6)},
    (4, "LQR"): 0.09,
    (4, "FLC"): 0.09,
}
"""Relative, of the printed EULERINT. Manoeuvre 4's row agrees with its target in no column: another target or a
misprint. The others' differences are what a target of four or five decimals makes of an arc cosine near zero."""

BALANCED_SPEED: dict[tuple[int, Law], float] = {
    (1, "FLC"): 2749,
    (1, "LQR"): 2655,
    (2, "FLC"): 4440,
    (2, "LQR"): 3785,
    (3, "FLC"): 3846,
    (3, "LQR"): 3328,
}
"""Peak speeds with min-max allocation, rpm."""

BREAKDOWN: dict[int, float] = {148: 24.2, 150: 22.5, 160: 20.1, 175: 19.0, 179: 19.0}
"""Slew about z (degrees): when feedback linearisation with the absolute output breaks down, s."""
