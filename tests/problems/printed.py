"""Every number that the five publications print, as printed, by the row of the matrix in which it has to stand."""

from __future__ import annotations

from collections.abc import Iterable

from problems.comparison import Row

_SUMS = {
    (1, "FLC"): "357.3 5.37 0.19",
    (1, "LQR"): "741.5 14.8 1.07",
    (2, "FLC"): "959.3 8.22 0.46",
    (2, "LQR"): "1699.5 21.2 1.83",
    (3, "FLC"): "857 9.22 0.48",
    (3, "LQR"): "1874.1 18.95 1.7",
    (4, "FLC"): "6.8 0.797 0.0036",
    (4, "LQR"): "18.9 1.81 0.017",
    (5, "FLC"): "8.1 0.8 0.0034",
    (5, "LQR"): "18.6 1.74 0.016",
    (6, "FLC"): "165.6 4.36 0.09",
    (6, "LQR"): "523.1 11.85 0.6153",
}
_EULERINT = {
    "FLC": "458.63 804.67 768.29 71.33 57.42 372.47",
    "LQR": "496.44 940.54 883.80 78.85 59.84 392.26",
}

PRINTED: dict[str, tuple[tuple[str, str], ...]] = {
    "rendezvous": (
        ("moments of inertia", "5621, 4547, 2364"),
        ("mass", "3200"),
        ("limits of torque", "50, 320"),
        ("altitude", "580"),
        ("final sigma, y", "0.4142"),
        ("formula of the final sigma", "tan(90/2)"),
        ("final position", "0, 0, -10"),
        ("figures 3 to 15", "drawn"),
        ("segments and points", "20, 3"),
        ("variables", "1333"),
        ("constraints", "960"),
        ("nonzeros", "11460"),
        *(
            (f"first position, case {case}", place)
            for case, place in enumerate(("20, 0, 0", "20, 4, 0", "20, 4, 4", "20, 4, -5", "25, -5, -5"), 1)
        ),
        *(
            (f"case {case}, paper {column}", time)
            for column, times in (
                ("GPM", "25.8727 26.1674 25.936 25.6607 28.7185"),
                ("GPOPS", "25.87 26.0336 26.1652 25.8986 28.2784"),
            )
            for case, time in enumerate(times.split(), 1)
        ),
    ),
    "formation_flying": (
        ("gravitational parameter", "398600"),
        ("leader's orbit", "7171"),
        ("J2", "0.0010826"),
        ("radius of the Earth", "6378.137"),
        ("first place", "300, -200, 500"),
        ("radius of the formation", "1000"),
        ("formation's plane", "1.73"),
        ("of SMC", "1e-3, 0.96, 10"),
        ("weights of optimal SMC", "0.2, 1e5, 1e10"),
        ("of optimal SMC", "5e-4, 1e-3"),
        ("bounds F_i and f_i", "1e-4, 2e-4"),
        ("SMC: |e(T)|", "1.11"),
        ("SMC: Delta-V", "2.358"),
        ("optimal SMC: |e(T)|", "0.06"),
        ("optimal SMC: Delta-V", "1.825"),
        ("figures 2 to 5", "drawn"),
    ),
    "reaction_wheels": (
        ("moments of inertia", "4, 4, 3"),
        ("inertia of a wheel", "5e-4"),
        ("limit of a wheel's speed", "5400, 5000"),
        ("K_T", "12.36e-3"),
        ("K_V", "1.294e-3"),
        ("final time", "60"),
        ("pyramid", "35.264, 45"),
        ("weights of the FLC", "0.1, 100"),
        ("weights of the LQR", "13131, 170, 2500"),
        *(
            (f"target of manoeuvre {m}", angles)
            for m, angles in enumerate(
                ("20, -30, -40", "-40, 30, 60", "-30, -50, -45", "5, 5, 5", "-5, 3, 2", "-3, 2, -40"), 1
            )
        ),
        ("K1", "0.0316"),
        ("K2", "0.2535"),
        ("K_q", "0.2608"),
        ("K_omega, x and y", "2.5091"),
        ("K_omega, z", "2.4566"),
        ("P of equation 50", "68.4008, -0.5, 2.0347"),
        ("eigenvalues", "2.0309, 68.4045"),
        ("equation 26", "q4"),
        *(
            (f"EULERINT {m} {law}", value)
            for law, values in _EULERINT.items()
            for m, value in enumerate(values.split(), 1)
        ),
        *(
            (f"sum of {what}, {m} {law}".replace("  ", " "), value)
            for (m, law), values in _SUMS.items()
            for what, value in zip(("|P| (J)", "|T| (N m s)", "T^2 (N^2 m^2 s)"), values.split(), strict=True)
        ),
        ("settling, 1 to 6 FLC", "about 40"),
        ("settling, 1 to 6 LQR", "about 40"),
        ("peak speed, 1 FLC", "about 3000"),
        ("peak speed, 1 LQR", "about 3000"),
        ("by the design", "<= 5000"),
        *(
            (f"in which {what} is smaller", "6")
            for what in ("EULERINT", "integral of sum T^2", "integral of sum |T|", "integral of sum |P|")
        ),
    ),
    "flexible_spacecraft": (
        ("moments of inertia", "100, 75, 50"),
        ("modal frequencies", "0.7, 1.0, 1.8, 2.5"),
        ("modal damping", "0.0056, 0.0086, 0.0128, 0.0252"),
        ("coupling", "6.4, -1.2, 1.1, 1.2, 1.2, 0.9, 2.5, -2.6, 2.2, -1.7, -0.8, -1.1"),
        ("orbital rate", "1.078e-2"),
        ("amplitude of the disturbance", "2.9e-4"),
        ("torque limit", "0.5"),
        ("rate limit", "20"),
        ("initial rates", "0.7, -0.5, -0.4"),
        ("gains c, eps, k, in U", "4.5, 0.3, 0.07"),
        ("gains c, eps, k, in J", "4.5, 0.3, 0.07"),
        ("equations 34, 35, 41, 42", "-1"),
        ("U, k = 0: peak |u_i|", "0.4"),
        ("U, k = 0: peak |omega_i|", "0.08"),
        ("U, k = 0: peak |omega_i| (rad/s), in the text", "0.065"),
        ("U, k = 0: modal range", "-0.05, 0.05"),
        ("U, k = 0: last max|q_i| > 0.01", "120"),
        ("J, k = 0: peak |u_i|", "0.3"),
        ("J, k = 0: peak |omega_i|", "0.068"),
        ("J, k = 0: peak |omega| (rad/s), in the text", "0.07"),
        ("J, k = 0: modal range", "-0.005, 0.03"),
        ("J, k = 0: last max|q_i| > 0.01", "100"),
        ("J, k = 0: effort", "25.26"),
        ("J, k = 0: integral of the angle", "172.7"),
        ("J, k = 0: braking torque", "0.17, -0.043, -0.24"),
        ("surface", "on the surface by 80 s"),
        ("effort of k = 0.05 / k = 0", "< 1"),
        ("|q_i| after 200 s", "about 0.001"),
    ),
    "tethered_formation": (
        ("limit of the angle", "pi/9"),
        ("limit of its rate", "0.1"),
        ("duration", "200"),
        ("control step", "0.1"),
        ("overshoot", "about 16.1"),
        ("swing after 150 s", "at equilibrium"),
        ("error of r", "grows, then shrinks"),
        ("thrust angle at 200 s", "decays to 0"),
        ("", "about 70"),
        ("angle beyond 20 deg", "never"),
        ("", "much weaker"),
        ("exact tracking", "claimed"),
        ("rival scheme", "claimed"),
        ("digit by digit", "claimed"),
    ),
}
"""By system: what stands in the row's quantity, and the print."""


def missing(system: str, rows: Iterable[Row]) -> list[tuple[str, str]]:
    """Return what a publication prints and no row has, or has without agreement or reason."""
    said = [(row.quantity, row.published.text) for row in rows if row.published is not None and row.passes]
    return [
        (place, text)
        for place, text in PRINTED[system]
        if not any(place in quantity and text in claim for quantity, claim in said)
    ]
