"""Model predictive control: a quadratic programme over a horizon at every step."""
