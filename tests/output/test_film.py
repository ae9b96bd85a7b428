"""Films: what they show is where the vehicle is, which way it points and which way it thrusts."""

import casadi as ca
import matplotlib.animation
import numpy as np
import pytest
from PIL import Image
from testing.internals import motion, new_figure, span
from testing.models import one_phase

import gnc_opt as go
from gnc_opt import cli
from gnc_opt.plot import Thruster, View, save_film
from gnc_opt.plot import film as film_module
from gnc_opt.spacecraft import mrp_rate

RATE = 0.5
"""Of the turn about z, rad/s."""


def turning() -> go.Problem:
    """A body that turns about z at a constant rate while a force along its own x carries it along."""
    model = go.Model("turning body")
    r, v = model.state("r", 3, unit="m"), model.state("v", 3, unit="m/s")
    sigma, q, m = model.state("sigma", 3), model.state("q", 4), model.state("m", unit="kg")
    thrust = model.control("F", 3, unit="N")
    angle = RATE * model.time
    c, s = ca.cos(angle), ca.sin(angle)
    force_L = ca.vertcat(c * thrust[0] - s * thrust[1], s * thrust[0] + c * thrust[1], thrust[2])
    half = RATE / 2
    q_rate = half * ca.vertcat(-q[3], q[2], -q[1], q[0])  # about z
    model.ode({r: v, v: force_L, sigma: mrp_rate(sigma, ca.vertcat(0, 0, RATE)), q: q_rate, m: -1})
    problem, leg = one_phase("a turn", model, initial=0.0, final=2.0, name="turn")
    leg.initial(r=0.0, v=0.0, sigma=0.0, q=[1, 0, 0, 0], m=9.0)
    leg.bounds(F=([1, 0, 0], [1, 0, 0]))
    problem.minimize(leg.final_time)
    return problem


def sampled(moved, view, n):
    return motion(moved, view, np.linspace(*span(moved, view), n))


@pytest.fixture(scope="module")
def solution():
    return go.solve(turning(), mesh="6x4", tol=None)


@pytest.mark.parametrize("attitude", ["sigma", "q"])
def test_axes_and_force_are_those_of_the_motion(solution, attitude):
    times = np.linspace(0, 2, 9)
    seen = sampled(solution, View("r", attitude, "F"), 9)
    turned = np.stack([np.cos(RATE * times), np.sin(RATE * times), 0 * times])
    assert np.allclose(seen.times, times)
    assert np.allclose(seen.dcm_BL[0], turned, atol=1e-6)  # the body's x in L
    assert np.allclose(seen.plumes["plume"].force(seen.dcm_BL), turned, atol=1e-6)
    assert seen.unit == "m"
    # r'' = (cos, sin) of the angle, from rest
    expected = np.stack([1 - np.cos(RATE * times), RATE * times - np.sin(RATE * times), 0 * times]) / RATE**2
    assert np.allclose(seen.position, expected, atol=1e-6)


def test_without_an_attitude_the_force_is_in_the_axes_drawn(solution):
    seen = sampled(solution, View("r", force="F"), 5)
    assert np.allclose(seen.plumes["plume"].force(None), [[1.0] * 5, [0.0] * 5, [0.0] * 5])


def test_two_components_lie_in_a_plane_upright():
    model = go.Model("hop")
    x, h = model.state("x", unit="km"), model.state("h", unit="km")
    model.ode({x: 1.0, h: 1 - x})
    problem, leg = one_phase("hop", model, initial=0.0, final=2.0, name="hop")
    leg.initial(x=0.0, h=0.0)
    problem.minimize(leg.final_time)
    solution = go.solve(problem, mesh="4x3", tol=None)
    seen = sampled(solution, View(("x", "h")), 3)
    assert np.allclose(seen.position, [[0, 1, 2], [0, 0, 0], [0, 0.5, 0]], atol=1e-7)
    assert seen.unit == "km"
    assert np.allclose(sampled(solution, View("h"), 3).position, [[0] * 3, [0] * 3, [0, 0.5, 0]], atol=1e-7)


def test_phases_follow_one_another():
    model = go.Model("runner")
    r = model.state("r", 2, unit="m")
    model.ode({r: ca.vertcat(1, 0)})
    other = go.Model("clock")
    tick = other.state("tick")
    other.ode({tick: 1.0})
    problem = go.Problem("relay")
    legs = [problem.phase(name, of) for name, of in (("first", model), ("second", model), ("pause", other))]
    for k, leg in enumerate(legs):
        leg.time(initial=1.0 * k, final=1.0 * k + 1)
    legs[0].initial(r=[0, 0])
    legs[1].initial(r=[1, 5])
    legs[2].initial(tick=0)
    problem.minimize(legs[2].final_time)
    seen = sampled(go.solve(problem, mesh="2x3", tol=None), View("r"), 5)
    assert np.allclose(seen.times, [0, 0.5, 1, 1.5, 2])  # the pause has no position
    assert np.allclose(seen.position[[0, 2]], [[0, 0.5, 1, 1.5, 2], [0, 0, 5, 5, 5]], atol=1e-7)


def test_film_of_a_solution_and_of_runs(solution, tmp_path):
    model = go.Model("glider")
    r = model.state("r", 3, unit="m")
    u = model.control("u", 3, unit="m/s")
    model.ode({r: u})
    regulator = go.design_lqr(model, [0, 0, 0], Q=1, R=1, dt=0.1)
    runs = [
        go.ClosedLoop(model, regulator, dt=0.1).simulate(x0={"r": start}, tf=1.0)
        for start in ([1, 0, 0], [0, 1, 0])
    ]
    view = View("r", force="u", keep_out={"rock": ((0, 0, 0), 0.3)}, down=True)
    path = save_film(
        runs[0], tmp_path / "new" / "runs.gif", view, others=[runs[1], solution], seconds=0.5, rate=8
    )
    with Image.open(path) as film:
        assert film.n_frames == 4
        assert film.info["duration"] == 120  # ms: GIF knows hundredths
        frames = []
        for k in range(4):
            film.seek(k)
            frames.append(np.asarray(film.convert("L"), dtype=float))
    assert all(np.any(frames[0] != frame) for frame in frames[1:])
    assert [path] == list(path.parent.iterdir())


@pytest.mark.parametrize(("view", "numbered"), [(View("r"), True), (View(attitude="sigma"), False)])
def test_axes_have_numbers_only_where_there_is_a_place(solution, monkeypatch, tmp_path, view, numbered):
    figures = []
    monkeypatch.setattr(
        film_module, "new_figure", lambda *size: figures.append(new_figure(*size)) or figures[0]
    )
    save_film(solution, tmp_path / "f.gif", view, seconds=0.25, rate=8)
    figures[0].canvas.draw()
    labels = [
        label.get_text() for axis in "xyz" for label in getattr(figures[0].axes[0], f"get_{axis}ticklabels")()
    ]
    assert any(labels) == numbered


def test_what_cannot_be_filmed_is_told(solution, tmp_path, monkeypatch):
    film = tmp_path / "f.gif"
    with pytest.raises(go.ArgumentError, match="give a solution or a run"):
        save_film("r.npz", film, View("r"))
    with pytest.raises(go.UnknownNameError, match="speed"):
        save_film(solution, film, View("speed"))
    with pytest.raises(go.UnknownNameError, match="G"):
        save_film(solution, film, View("r", force="G"))
    with pytest.raises(go.ArgumentError, match="position q has 4 components"):
        save_film(solution, film, View("q"))
    with pytest.raises(go.ArgumentError, match=r"r has no component r\[3\]: it has r\[0\]"):
        save_film(solution, film, View("r[3]"))
    with pytest.raises(go.ArgumentError, match=r"F of 3 components: name one of them, such as 'F\[0\]'"):
        save_film(solution, film, View("r", force={"main": Thruster("F", (1, 0, 0))}))
    with pytest.raises(go.ArgumentError, match="position r, v has 6 components"):
        save_film(solution, film, View(("r", "v")))
    with pytest.raises(
        go.ArgumentError, match=r"m has 1 components: give modified Rodrigues parameters \(3\)"
    ):
        save_film(solution, film, View("r", attitude="m"))
    with pytest.raises(go.ArgumentError, match=r"'\.gif' or '\.mp4'"):
        save_film(solution, tmp_path / "f.avi", View("r"))
    with pytest.raises(go.ArgumentError, match="length of a film"):
        save_film(solution, film, View("r"), seconds=0)
    monkeypatch.setattr(matplotlib.animation.FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(go.GncOptError, match="ffmpeg"):
        save_film(solution, tmp_path / "f.mp4", View("r"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({}, "shows nothing that moves"),
        ({"position": "r", "keep_out": {"rock": 1.0}}, "'rock' to keep out of is no"),
        ({"position": "r", "keep_out": {"rock": ((0, 0), 1.0)}}, "the centre of 'rock' .* three finite"),
        (
            {"position": "r", "keep_out": {"rock": ((0, 0, 0), (1, 1, 0))}},
            "the radius of 'rock' .* length > 0",
        ),
        ({"position": "r", "force": {"main": "F"}}, "thruster 'main' is a str"),
        ({"position": "r", "force": {"main": Thruster("F[0]", (0, 0, 0))}}, "'main' has no direction"),
        ({"position": "r", "force": {"main": Thruster("F[0]", (1, 0))}}, "direction of the thruster 'main'"),
    ],
)
def test_views_that_cannot_be_meant_are_refused_where_they_are_written(wrong, message):
    with pytest.raises(go.ArgumentError, match=message):
        View(**wrong)


def test_nothing_is_left_of_a_film_that_breaks_off(solution, tmp_path, monkeypatch):
    film = tmp_path / "f.gif"
    film.write_bytes(b"the old one")

    def interrupted(self, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(matplotlib.animation.PillowWriter, "grab_frame", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_film(solution, film, View("r"), seconds=0.2, rate=10)
    assert film.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [film]


def test_command_line(solution, tmp_path, capsys):
    saved = str(solution.save(tmp_path / "turn.npz"))
    out = str(tmp_path / "turn.gif")
    look = ["--position", "r", "--attitude", "sigma", "--keep-out", "1", "0", "0", "0.1"]
    assert cli.main(["film", saved, *look, "--seconds", "0.3", "--rate", "10", "--output", out]) == 0
    assert out in capsys.readouterr().out
    with Image.open(out) as film:
        assert film.n_frames == 3
    assert cli.main(["film", saved, "--position", "nose"]) == 2
    assert "nose" in capsys.readouterr().err
    assert cli.main(["film", str(tmp_path / "none.npz"), "--position", "r"]) == 2
    assert "none.npz" in capsys.readouterr().err
