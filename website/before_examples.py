"""What the examples of the reference know: the first page's problem, and a loop that flies its cart."""

import numpy as np

import gnc_opt as go
from gnc_opt.simulation import Noise, Normal, Quantity

cart = go.Model("double integrator")
q, v = cart.state("q", unit="m"), cart.state("v", unit="m/s")
a = cart.control("a", unit="m/s^2")
cart.ode({q: v, v: a})

problem = go.Problem("rest to rest in minimum time")
leg = problem.phase("leg", cart)
leg.time(initial=0.0, final=(0.1, 10.0))
leg.initial(q=1.0, v=0.0)
leg.final(q=0.0, v=0.0)
leg.bounds(a=(-1.0, 1.0))
problem.minimize(leg.final_time)
solution = go.solve(problem)

regulator = go.design_lqr(cart, [0.0, 0.0], Q=1, R=1, dt=0.1)
loop = go.ClosedLoop(
    cart, regulator, sensors=[Noise("gauge", 1e-3, on="q")], quantities=[Quantity("overshoot", -q, "m")]
)
x0 = np.array([1.0, 0.0])
run = loop.simulate(x0, tf=8.0)
spread = {"initial.q": Normal(0.1), "initial.v": Normal(0.02)}
campaign = go.monte_carlo(
    *(loop, 20), x0=x0, tf=8.0, seed=1, dispersions=spread, limits={"q": 0.01}, executor="serial"
)
