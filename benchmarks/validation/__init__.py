"""Whether the results are right: ``python -m benchmarks.validation.NAME``.

* `engine`: accuracy, verdict and time of every known answer, those of a JSON set (`problem_set`) included; what moved
  since an earlier run;
* `robustness`: the same with scaled constants of the solver;
* `verdict`: planted wrong answers and right ones, and what the verification reports;
* `published`: five published systems, number by number; `basilisk`: the tracked rendezvous in another simulator;
* `lower_bounds`: lower bounds of the cost of rendezvous between random boundary values;
* `rendezvous_minima`: local minima of the published rendezvous.
"""
