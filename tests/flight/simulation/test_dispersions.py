"""Dispersions: their moments, their geometry, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest, norm, truncnorm, uniform
from testing.internals import check_dispersions, draw_dispersed_parameters

from gnc_opt.errors import ArgumentError, UnknownNameError
from gnc_opt.model import Layout, Variable
from gnc_opt.simulation import Choice, Normal, RandomDirection, RandomRotation, Uniform, UniformInBall
from gnc_opt.spacecraft import mrp_difference, mrp_from_axis_angle

COUNT = 4000
LAYOUT = Layout("parameter", (*(Variable(n, 3) for n in ("a", "b", "c")), Variable("m")))
NOMINAL = np.array([1.0, 2.0, -4.0, *np.zeros(6), 5.0])


def samples(dispersion, nominal, count=COUNT):
    """Draws (count, size) from one generator."""
    generator = np.random.default_rng(5)
    nominal = np.asarray(nominal, dtype=float)
    dispersion.check_nominal_value("x", nominal)
    return np.array([dispersion.draw(generator, nominal) for _ in range(count)])


def is_distributed(values, distribution):
    return kstest(values, distribution.cdf).pvalue > 1e-3


def test_normal_has_its_mean_and_deviation_per_component():
    drawn = samples(Normal([0.1, 1.0], mean=[0.0, 3.0]), [2.0, -1.0])
    assert is_distributed(drawn[:, 0], norm(2.0, 0.1))
    assert is_distributed(drawn[:, 1], norm(2.0, 1.0))
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 4 / np.sqrt(COUNT)


def test_relative_deviations_are_shares_of_the_nominal_value():
    drawn = samples(Normal(0.01, relative=True), [3200.0, -50.0])
    assert is_distributed(drawn[:, 0], norm(3200.0, 32.0))
    assert is_distributed(drawn[:, 1], norm(-50.0, 0.5))
    drawn = samples(Uniform(-0.05, 0.05, relative=True), [10.0])
    assert is_distributed(drawn[:, 0], uniform(9.5, 1.0))


@pytest.mark.parametrize("truncate", [0.5, 3.0])
def test_truncated_normal(truncate):
    drawn = samples(Normal(2.0, mean=1.0, truncate=truncate), [4.0])[:, 0]
    assert np.max(np.abs(drawn - 5)) <= 2 * truncate
    assert is_distributed(drawn, truncnorm(-truncate, truncate, 5, 2))


def test_choice_takes_each_value_equally_often():
    drawn = samples(Choice([1.0, 2.0, 5.0]), [0.0])[:, 0]
    values, counts = np.unique(drawn, return_counts=True)
    assert list(values) == [1, 2, 5]
    assert np.all(np.abs(counts - COUNT / 3) < 4 * np.sqrt(COUNT * 2 / 9))


def test_sphere_and_ball_have_no_preferred_direction():
    nominal = np.array([20.0, 4.0, -5.0])
    on_sphere = samples(RandomDirection(0.2), nominal) - nominal
    assert np.linalg.norm(on_sphere, axis=1) == pytest.approx(0.2, abs=1e-13)
    in_ball = samples(UniformInBall(0.2), nominal) - nominal
    assert is_distributed((np.linalg.norm(in_ball, axis=1) / 0.2) ** 3, uniform)
    for drawn, second_moment in ((on_sphere, 0.2**2 / 3), (in_ball, 0.2**2 / 5)):
        scatter = drawn.T @ drawn / COUNT
        assert scatter == pytest.approx(second_moment * np.eye(3), abs=5 * second_moment / np.sqrt(COUNT))
    # Archimedes: the height of a point on the sphere is uniformly distributed
    assert is_distributed(on_sphere[:, 2] / 0.2, uniform(-1, 2))


def test_the_length_of_a_deviation_can_itself_be_drawn():
    drawn = samples(RandomDirection(Uniform(0.1, 0.3)), np.zeros(3))
    assert is_distributed(np.linalg.norm(drawn, axis=1), uniform(0.1, 0.2))


def test_a_turn_has_its_angle_about_any_axis():
    angle = np.radians(2)
    q = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_quat(scalar_first=True)
    turned = samples(RandomRotation(angle), q)
    assert np.linalg.norm(turned, axis=1) == pytest.approx(1, abs=1e-14)
    between = Rotation.from_quat(q, scalar_first=True).inv() * Rotation.from_quat(turned, scalar_first=True)
    assert between.magnitude() == pytest.approx(angle, abs=1e-14)
    axes = between.as_rotvec() / angle
    assert axes.T @ axes / COUNT == pytest.approx(np.eye(3) / 3, abs=5 / 3 / np.sqrt(COUNT))


@pytest.mark.parametrize("shadow", [False, True])
def test_a_turn_of_modified_rodrigues_parameters_stays_in_their_set(shadow):
    sigma = mrp_from_axis_angle([1.0, 2.0, 0.5], 2.5)
    sigma = -sigma / (sigma @ sigma) if shadow else sigma
    for turned in samples(RandomRotation(0.05), sigma, 50):
        assert 4 * np.arctan(np.linalg.norm(mrp_difference(turned, sigma)) / 4) == pytest.approx(
            0.05, abs=1e-13
        )
        assert np.linalg.norm(turned - sigma) < 0.1


def test_draws_depend_on_seed_run_and_name_alone():
    both = {"a": Normal(1.0), "m": Uniform(0, 1)}
    first = draw_dispersed_parameters(both, LAYOUT, NOMINAL, 7, 3)
    assert np.array_equal(
        first, draw_dispersed_parameters(dict(reversed(both.items())), LAYOUT, NOMINAL, 7, 3)
    )
    alone = draw_dispersed_parameters({"a": Normal(1.0)}, LAYOUT, NOMINAL, 7, 3)
    assert np.array_equal(alone[:3], first[:3]) and alone[9] == 5
    others = [draw_dispersed_parameters(both, LAYOUT, NOMINAL, *key) for key in ((7, 4), (8, 3))]
    assert all(np.all(first[[0, 1, 2, 9]] != other[[0, 1, 2, 9]]) for other in others)
    same = draw_dispersed_parameters({"a": Normal(1.0), "b": Normal(1.0)}, LAYOUT, np.zeros(10), 7, 3)
    assert np.all(same[:3] != same[3:6])


@pytest.mark.parametrize(
    ("dispersions", "message"),
    [
        ({"plant.mass": Normal(1.0)}, "did you mean 'plant.m'"),
        ({"a": 0.1}, "the dispersion of 'a' must be of type .*not float"),
        ({"a": Normal([1.0, 2.0])}, "'a' is given 2 values"),
        ({"b": Normal(0.1, relative=True)}, "the nominal value 0"),
        ({"m": RandomRotation(0.1)}, "neither a quaternion"),
        ({"m": Choice([[1.0, 2.0]])}, "a choice of 'm'"),
        ([("a", Normal(1.0))], "must be of type Mapping, not list"),
    ],
)
def test_what_does_not_fit_is_refused(dispersions, message):
    layout = Layout("parameter", (*LAYOUT.variables, Variable("plant.m")))
    with pytest.raises((ArgumentError, UnknownNameError), match=message):
        check_dispersions(dispersions, layout, np.append(NOMINAL, 1.0))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Normal(-1.0), lambda: Normal(np.nan), lambda: Normal(1.0, mean=np.inf),
        lambda: Normal(1.0, truncate=0.0), lambda: Uniform(1.0, 0.0), lambda: Uniform(0.0, np.inf),
        lambda: RandomDirection(Uniform(0, 1, relative=True)), lambda: Choice([]),
        lambda: RandomDirection(-0.1), lambda: UniformInBall(np.inf),
        lambda: RandomRotation(Normal(0.1, relative=True)),
        lambda: RandomRotation(0.1).check_nominal_value("initial.q", np.array([1.0, 1.0, 0.0, 0.0])),
    ],
)  # fmt: skip
def test_impossible_dispersions_are_refused(wrong):
    with pytest.raises(ArgumentError):
        wrong()
