"""Estimators against independent filters, closed forms and each other."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.internals import (
    SigmaRegression,
    build_euclidean_error_coordinates,
    factorise_semidefinite,
    solve_triangular_left,
    solve_triangular_right,
)
from testing.models import dynamics

import gnc_opt as go
from gnc_opt.estimation import FilterOptions, Measurement, design_ekf, design_ukf
from gnc_opt.spacecraft import mrp_difference, mrp_rate, mrp_retraction

DT = 0.1
DESIGNS = [design_ekf, design_ukf]


def cart() -> go.Model:
    model = go.Model("cart")
    q, v, a = model.state("q", unit="m"), model.state("v", unit="m/s"), model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    model.output("twice", 2 * q, unit="m")
    return model


CART = {"sigma0": {"q": 1.0, "v": 2.0}, "process_noise": {"v": 0.3}, "dt": DT}
F = np.array([[1, DT], [0, 1.0]])
Q = 0.09 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
G = np.array([DT**2 / 2, DT])


class Kalman:
    """The textbook filter with dense matrices, in the standard form."""

    def __init__(self, x, P):
        self.x, self.P = np.array(x, dtype=float), np.array(P, dtype=float)

    def update(self, H, R, y):
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        nu = y - H @ self.x
        self.x, self.P = self.x + K @ nu, self.P - K @ S @ K.T
        return nu @ np.linalg.solve(S, nu)

    def predict(self, F, Q, b):
        self.x, self.P = F @ self.x + b, F @ self.P @ F.T + Q


@pytest.mark.parametrize("design", DESIGNS)
def test_linear_filters_are_the_textbook_one_to_rounding(design):
    sensors = [Measurement("q", 0.1), Measurement("twice", 0.3)]
    estimator = design(cart(), [0.5, -0.2], sensors, **CART)
    other, rng, z, nis = Kalman([0.5, -0.2], np.diag([1.0, 4.0])), np.random.default_rng(2), None, 0.0
    for k in range(40):
        y, u = rng.normal(size=2), rng.normal()
        if k % 7 == 3:
            y[0] = np.nan
        else:
            nis += other.update(np.array([[1.0, 0]]), 0.01, y[:1])
        other.update(np.array([[2.0, 0]]), 0.09, y[1:])
        x, z = estimator(k * DT, y, u, z)
        assert np.allclose(x, other.x, rtol=1e-13, atol=1e-13)
        other.predict(F, Q, G * u)
    assert np.allclose(estimator.estimate(z), other.x, atol=1e-13)
    assert np.allclose(estimator.covariance(z), other.P, rtol=1e-12)
    memory = estimator.memory
    assert z[memory.slice("q_nis")] == pytest.approx(nis, rel=1e-12)
    assert z[memory.slice("q_taken")] == 34 and z[memory.slice("twice_taken")] == 40


@pytest.mark.parametrize("bias", [0.0, 0.5])
@pytest.mark.parametrize("design", DESIGNS)
def test_a_single_state_is_estimated_as_by_the_textbook(design, bias):
    """x' = u, one number, and what its sensor is off."""
    model = go.Model("tank")
    model.ode({model.state("x"): model.control("u")})
    sensor = Measurement("x", 0.1, bias=bias) if bias else Measurement("x", 0.1)
    estimator = design(model, [0.5], [sensor], sigma0={"x": 1.0}, process_noise={"x": 0.3}, dt=DT)
    n, rng, z = 1 + bool(bias), np.random.default_rng(3), None
    other = Kalman([0.5, 0.0][:n], np.diag([1.0, bias**2][:n]))
    for k in range(10):
        y, u = rng.normal(size=1), rng.normal()
        other.update(np.ones((1, n)), 0.01, y)
        x, z = estimator(k * DT, y, [u], z)
        assert x == pytest.approx(other.x[:1], rel=1e-12, abs=1e-12)
        other.predict(np.eye(n), np.diag([0.09 * DT, 0.0][:n]), np.array([DT * u, 0.0][:n]))
    assert estimator.covariance(z) == pytest.approx(other.P[:1, :1], rel=1e-10)


@pytest.mark.parametrize("design", DESIGNS)
def test_the_steady_covariance_solves_the_riccati_equation(design):
    estimator = design(cart(), [0.0, 0.0], [Measurement("q", 0.1)], **CART)
    z = None
    for k in range(300):
        _, z = estimator(k * DT, 0.0, 0.0, z)
    H, R = np.array([[1.0, 0]]), np.array([[0.01]])
    steady = scipy.linalg.solve_discrete_are(F.T, H.T, Q, R)
    assert np.allclose(estimator.covariance(z), steady, rtol=1e-10)
    gain = steady @ H.T / (steady[0, 0] + 0.01)
    x, _ = estimator(30.0, 1.0, 0.0, z)
    assert np.allclose(x, gain[:, 0], rtol=1e-10)
    after = np.sqrt(np.diag(steady - gain @ H @ steady))
    assert np.allclose(estimator.explain()["steady-state standard deviation"], after, rtol=1e-9)


def test_noise_enters_as_the_exact_integral_of_a_damped_plant():
    model, *_ = dynamics("damped", "q v", "a", lambda q, v, a: {q: v, v: a - 2 * q - 0.7 * v})
    errors = []
    for substeps in (1, 2):
        estimator = design_ekf(
            model, [0, 0], [Measurement("q", 1e9)], sigma0={"q": 0.0, "v": 0.0}, process_noise={"v": 1.0},
            dt=0.2, options=FilterOptions(substeps=substeps),
        )  # fmt: skip
        _, z = estimator(0.0, np.nan, 0.0)
        A = np.array([[0, 1], [-2, -0.7]])
        van_loan = scipy.linalg.expm(np.block([[-A, np.diag([0, 1.0])], [np.zeros((2, 2)), A.T]]) * 0.2)
        exact = van_loan[2:, 2:].T @ van_loan[:2, 2:]
        errors.append(np.max(np.abs(estimator.covariance(z) / exact - 1)))
    assert errors[0] < 2.5e-3 and errors[1] < errors[0] / 6


def test_predictions_follow_the_nonlinear_dynamics_within_the_limits():
    model, *_ = dynamics("pendulum", "q v", "a", lambda q, v, a: {q: v, v: a - ca.sin(q)})
    estimator = design_ekf(
        model, [1.0, 0.0], [Measurement("q", 0.1)], sigma0={"q": 0, "v": 0}, dt=0.05,
        options=FilterOptions(limits=(-0.5, 0.5)),
    )  # fmt: skip
    z, x = None, np.array([1.0, 0.0])
    for k in range(20):
        told, z = estimator(k * 0.05, 3.0, 7.0, z)  # what is known exactly takes no sample
        assert np.allclose(told, x, atol=1e-6)
        x = scipy.integrate.solve_ivp(
            lambda t, s: [s[1], 0.5 - np.sin(s[0])], (0, 0.05), x, rtol=1e-11, atol=1e-11
        ).y[:, -1]


def test_a_bias_is_estimated_as_the_augmented_filter_does():
    sensors = [Measurement("q", 0.1, bias=0.5, bias_walk=0.2), Measurement("v", 0.05)]
    estimator = design_ekf(cart(), [0.0, 0.0], sensors, **CART)
    other = Kalman(np.zeros(3), np.diag([1.0, 4.0, 0.25]))
    F3, Q3 = scipy.linalg.block_diag(F, 1), scipy.linalg.block_diag(Q, 0.04 * DT)
    rng, z = np.random.default_rng(4), None
    for k in range(25):
        y = rng.normal(size=2)
        other.update(np.array([[1.0, 0, 1]]), 0.01, y[:1])
        other.update(np.array([[0, 1.0, 0]]), 0.0025, y[1:])
        x, z = estimator(k * DT, y, 0.0, z)
        assert np.allclose(x, other.x[:2], atol=1e-12)
        other.predict(F3, Q3, 0.0)
    assert np.allclose(z[estimator.memory.slice("q_bias_hat")], other.x[2], atol=1e-12)
    assert np.allclose(estimator.covariance(z), other.P[:2, :2], atol=1e-12)
    many = estimator.covariance(np.stack([z, z], axis=1))
    assert many.shape == (2, 2, 2) and np.array_equal(many[1], estimator.covariance(z))


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize(("period", "delay"), [(1, 2), (3, 0), (3, 2), (2, 3)])
def test_slow_and_late_samples_are_worth_what_all_samples_at_once_are(design, period, delay):
    """The estimate is the conditional mean of a joint normal distribution of states and samples."""
    n = 9
    sensors = [Measurement("q", 0.1, period=period * DT, delay=delay * DT)]
    estimator = design(cart(), [0.3, -0.1], sensors, **CART)
    # states as linear functions of x_0 and the noises w_k: columns of L with covariances D
    D = scipy.linalg.block_diag(np.diag([1.0, 4.0]), *[Q] * n)
    L = [np.hstack([np.eye(2), np.zeros((2, 2 * n))])]
    for k in range(n):
        step = F @ L[-1]
        step[:, 2 + 2 * k : 4 + 2 * k] = np.eye(2)
        L.append(step)
    rng, z, rows, seen = np.random.default_rng(7), None, [], []
    for k in range(n):
        y = rng.normal()
        if k >= delay and (k - delay) % period == 0:
            rows.append(L[k - delay][:1])
            seen.append(y)
        told, z = estimator(k * DT, y, 0.0, z)
        mean = np.linalg.matrix_power(F, k) @ [0.3, -0.1]
        if rows:
            H = np.vstack(rows)
            S = H @ D @ H.T + 0.01 * np.eye(len(rows))
            prior = np.array(
                [(np.linalg.matrix_power(F, s) @ [0.3, -0.1])[0] for s in _times(k, period, delay)]
            )
            mean = mean + L[k] @ D @ H.T @ np.linalg.solve(S, np.array(seen) - prior)
        assert np.allclose(told, mean, atol=1e-10)


def _times(k, period, delay):
    return [s - delay for s in range(delay, k + 1) if (s - delay) % period == 0]


def test_samples_outside_the_gate_change_nothing_and_are_counted():
    estimator = design_ekf(cart(), [0.0, 0.0], [Measurement("q", 0.1, gate=0.99)], **CART)
    free = design_ekf(cart(), [0.0, 0.0], [Measurement("q", 0.1)], **CART)
    bound = np.sqrt(scipy.stats.chi2.ppf(0.99, 1) * (1 + 0.01))
    inside, z = estimator(0.0, bound * (1 - 1e-9), 0.0)
    assert np.array_equal(inside, free(0.0, bound * (1 - 1e-9), 0.0)[0]) and inside[0] > 2.5
    assert z[estimator.memory.slice("q_taken")] == 1 and z[estimator.memory.slice("q_refused")] == 0
    for outlier in (bound * (1 + 1e-9), -1e6):
        outside, z = estimator(0.0, outlier, 0.0)
        assert np.array_equal(outside, [0.0, 0.0])
        assert np.array_equal(z[:5], free(0.0, np.nan, 0.0)[1][:5])
        assert z[estimator.memory.slice("q_taken")] == 0 and z[estimator.memory.slice("q_refused")] == 1


def test_lost_samples_are_predicted_then_nothing_is_told_until_the_next_good_one():
    estimator = design_ekf(
        cart(), [0.0, 1.0], [Measurement("q", 0.1, period=2 * DT)], options=FilterOptions(hold=2), **CART
    )
    z, told = None, []
    for k in range(12):
        x, z = estimator(k * DT, 0.1 * k if k in (0, 10) else [np.nan, np.inf, 1e31][k % 3], 0.0, z)
        told.append(np.isfinite(x).all())
    # samples are due at 0, 2, 4, ...: those at 2 and 4 are bridged, from the one at 6 on nothing is told
    assert told == [True] * 6 + [False] * 4 + [True] * 2
    assert x[0] == pytest.approx(1.1, abs=0.1)


def test_a_bad_guess_and_a_good_sensor_leave_a_covariance():
    model = cart()
    estimator = design_ekf(
        model, [0, 0], [Measurement("q", 1e-6)], sigma0={"q": 1e6, "v": 1e6}, process_noise={}, dt=DT
    )
    z = None
    for k in range(3):
        x, z = estimator(k * DT, 5.0 + 2.0 * k * DT, 0.0, z)
    P = estimator.covariance(z)
    # the line through three points, one step ahead: the covariance of least squares
    rows = np.array([[1, -3 * DT], [1, -2 * DT], [1, -DT]])
    exact = 1e-12 * np.linalg.inv(rows.T @ rows)
    assert np.allclose(P, exact, rtol=1e-3)
    assert x == pytest.approx([5.4, 2.0], abs=1e-6)


def test_errors_that_nothing_connects_are_not_stored():
    model, *_ = dynamics("two", "q v w", "a", lambda q, v, w, a: {q: v, v: a, w: -w})
    sensors = [Measurement("q", 0.1), Measurement("w", 0.1)]
    given = {"sigma0": {"q": 1, "v": 1, "w": 1}, "dt": DT}
    estimator = design_ekf(model, [0, 0, 0], sensors, **given)
    assert estimator.memory["covariance"].size == 4
    assert design_ukf(model, [0, 0, 0], sensors, **given).memory["covariance"].size == 6
    _, z = estimator(0.0, [0.0, 0.0], 0.0)
    P = estimator.covariance(z)
    assert P[0, 1] == P[1, 0] != 0 and P[2, 0] == P[2, 1] == 0 < P[2, 2]


def test_a_difference_of_ones_own_closes_the_circle():
    model, q, _a = dynamics("radar", "q:2", "a:2", lambda q, a: {q: a})
    model.output("bearing", ca.atan2(q[1], q[0]), unit="rad")
    around = lambda y, ref: ca.atan2(ca.sin(y - ref), ca.cos(y - ref))  # noqa: E731
    given = {"sigma0": {"q": 0.1}, "dt": DT}
    right, wrong = (
        design_ekf(model, [-1.0, 1e-3], [Measurement("bearing", 1e-3, difference=d)], **given)
        for d in (around, None)
    )
    assert right(0.0, -np.pi + 1e-3, [0, 0])[0] == pytest.approx([-1.0, -1e-3], abs=1e-5)
    assert abs(wrong(0.0, -np.pi + 1e-3, [0, 0])[0][1]) > 1.0


def test_what_directions_leave_is_added_up():
    """x0^2 of n errors with variances 0.3: beyond the slope its variance is 2 (0.3)^2."""
    for n in (1, 2, 5):
        x, P = ca.SX.sym("x", n), ca.SX.sym("P", n, n)
        source, target = build_euclidean_error_coordinates(n), build_euclidean_error_coordinates(1)
        mean, _, left = SigmaRegression().fit_linear_model(lambda s: s[0] ** 2, source, target, x, P)
        found = ca.Function("f", [x, P], [mean, left])(0.7, 0.3 * np.eye(n))
        assert [float(v) for v in found] == pytest.approx([0.49 + 0.3, 2 * 0.3**2], rel=1e-13)


@pytest.mark.parametrize("others", [0, 3, 9])
def test_what_a_range_leaves_does_not_depend_on_what_else_is_estimated(others):
    """Its innovation has the variance of sqrt(x^2 + y^2), here by quadrature, less what is of higher order."""
    model = go.Model("seen by a range finder")
    r, rest = model.state("r", 2), model.state("rest", 1 + others)
    model.ode({r: [0, 0], rest: ca.DM.zeros(1 + others)})
    model.output("range", ca.norm_2(r))
    ukf = design_ukf(
        model, {"r": [100, 0], "rest": np.zeros(1 + others)}, [Measurement("range", 0.01)],
        sigma0={"r": [0.01, 4.0], "rest": 1.0}, dt=1.0,
    )  # fmt: skip
    nis = [float(ukf(0.0, [y], [])[1][ukf.memory.slice("range_nis")][0]) for y in (99.0, 100.0, 101.0)]
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    weights = np.outer(weights, weights) / np.sum(weights) ** 2
    ranges = np.hypot(100 + 0.01 * nodes[:, None], 4 * nodes)
    variance = np.sum(weights * (ranges - np.sum(weights * ranges)) ** 2) + 0.01**2
    assert 2 / (nis[0] - 2 * nis[1] + nis[2]) == pytest.approx(variance, rel=0.01)


def test_roots_of_singular_covariances():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 2))
    P = A @ A.T
    P[1] = P[:, 1] = 0
    p = ca.SX.sym("p", 4, 4)
    root = np.array(ca.Function("L", [p], [factorise_semidefinite(p)])(P))
    assert np.allclose(root @ root.T, P, atol=1e-13)
    assert np.allclose(root, np.tril(root))
    assert not root[:, 1].any()
    full = np.linalg.cholesky(P + np.eye(4))
    b = rng.normal(size=(4, 3))
    left = np.array(ca.Function("s", [p], [solve_triangular_left(p, ca.SX(ca.DM(b)))])(full))
    right = np.array(ca.Function("s", [p], [solve_triangular_right(ca.SX(ca.DM(b.T)), p)])(full))
    assert np.allclose(full @ left, b) and np.allclose(right @ full, b.T)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"measurements": []}, "measures nothing"),
        ({"measurements": None}, "must be of type Measurement, not NoneType"),
        ({"measurements": ["q"]}, "must be of type Measurement, not str"),
        (
            {"measurements": [Measurement("q", 1), Measurement("q", 2)]},
            "measures 'q' twice: declare an output",
        ),
        ({"measurements": [Measurement("r", 1)]}, "no measurement 'r'"),
        ({"measurements": [Measurement("push", 1)]}, "depends on a control"),
        (
            {"measurements": [Measurement("q", [1, 2])]},
            "the sigma of the measurement of 'q' is given 2 values",
        ),
        ({"measurements": [Measurement("q", 1, period=0.25)]}, "not a multiple"),
        ({"measurements": [Measurement("q", 1, period=1e-12)]}, "shorter than the control step"),
        ({"measurements": [Measurement("q", 1, delay=0.25)]}, "not a multiple"),
        (
            {"measurements": [Measurement("q", 1, difference=lambda a, b: 1.0)]},
            "depend on its arguments: return 1 comp",
        ),
        ({"measurements": [Measurement("q", 1, difference=3)]}, "'q' cannot be evaluated"),
        ({"measurements": [Measurement("q", 1, difference=lambda a: a)]}, "'q' cannot be evaluated"),
        ({"measurements": [Measurement("q", 1, delay=1e3)]}, "is 10000 control steps, and the filter"),
        ({"sigma0": {"q": 1}}, "has no entry for state 'v'"),
        ({"sigma0": {"q": 1, "vv": 1}}, "no state 'vv': did you mean 'v'"),
        ({"sigma0": 1.0}, "sigma0 of 'EKF' must be of type Mapping, not float"),
        ({"sigma0": {"q": 1, "v": -1}}, "sigma0 of 'EKF' for 'v'"),
        ({"sigma0": {"q": 1, "v": 1, "w": 1}}, "no state 'w'"),
        ({"process_noise": {"v": np.nan}}, "process_noise of 'EKF' for 'v'"),
        ({"process_noise": [1, 2]}, "must be of type Mapping"),
        ({"process_noise": np.eye(2)}, "process_noise of 'EKF' must be of type Mapping, not ndarray"),
        ({"x0": [0, np.inf]}, "has no finite 'v'"),
        ({"x0": {"q": 0}}, "has no finite 'v'"),
        ({"x0": {"q": 0, "w": 0}}, "no state 'w'"),
        ({"dt": 0}, "control step"),
        ({"options": FilterOptions(substeps=0)}, "substeps"),
        ({"options": FilterOptions(hold=-1)}, "bridges"),
        ({"options": FilterOptions(t0=np.nan)}, "t0 of 'EKF'"),
        ({"options": FilterOptions(limits=(1, 0))}, "no authority"),
        ({"options": {"hold": 1}}, "the options of 'EKF'"),
        ({"model": None}, "the model of an estimator"),
    ],
)
def test_designs_that_cannot_be_meant_are_refused(change, message):
    model = cart()
    model.output("push", model.symbol("q") + model.symbol("a"))
    given = {"model": model, "x0": [0, 0], "measurements": [Measurement("q", 1)], **CART} | change
    with pytest.raises(go.GncOptError, match=message):
        design_ekf(given.pop("model"), given.pop("x0"), given.pop("measurements"), **given)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("q", 0.0), "sigma of the measurement of 'q' is 0.*> 0"),
        (("q", "a"), "not a number"),
        ((1, 0.1), "name a state or an output"),
        (("q", 0.1, -1.0), "period"),
        (("q", 0.1, None, -1.0), "delay"),
        (("q", 0.1, None, 0.0, -1.0), "bias"),
        (("q", 0.1, None, 0.0, 0.0, np.inf), "bias_walk"),
        (("q", 0.1, None, 0.0, 0.0, 0.0, 1.0), "gate.*probability"),
        (("q", 0.1, None, 0.0, 0.0, 0.0, 0.0), "gate"),
    ],
)
def test_measurements_that_cannot_be_meant_are_refused(arguments, message):
    with pytest.raises(go.ArgumentError, match=message):
        Measurement(*arguments)


@pytest.mark.parametrize(
    ("retraction", "error", "message"),
    [
        (None, go.ModelError, "the retraction of state 'att' in model 'm' is missing"),
        (lambda ref, e: mrp_retraction(ref, 2 * e), go.DesignError, "is not the inverse of its difference"),
        (lambda ref, e: ref + e, go.DesignError, "is not the inverse"),
    ],
)
def test_attitudes_need_their_way_back(retraction, error, message):
    model, att, _w = dynamics("m", "att:3", "w:3", lambda att, w: {att: mrp_rate(att, w)})
    model.difference(att, mrp_difference, retraction)
    with pytest.raises(error, match=message):
        design_ekf(model, [0.3, 0.1, 0], [Measurement("att", 1e-3)], sigma0={"att": 0.1}, dt=DT)


def test_names_of_estimated_biases_must_be_free():
    model, *_ = dynamics("m", "q q_bias", "a", lambda q, b, a: {q: a, b: 0 * b})
    with pytest.raises(go.ArgumentError, match="would be called like a state"):
        design_ekf(model, [0, 0], [Measurement("q", 1, bias=1)], sigma0={"q": 1, "q_bias": 1}, dt=DT)


def test_what_is_not_seen_is_reported():
    model, *_ = dynamics("m", "q w", "a", lambda q, w, a: {q: a, w: 0 * w})
    told = design_ekf(model, [0, 0], [Measurement("q", 1)], sigma0={"q": 1, "w": 1}, dt=DT).explain()
    assert told["unobservable states"] == "w"
    assert "steady-state standard deviation" not in [fact.name for fact in told]
    pairs = pairwise(fact.name for fact in told)
    assert ("initial standard deviation", "process noise") in pairs
