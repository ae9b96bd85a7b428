"""Whether the results are right: ``python -m benchmarks.validation.NAME``.

* `regression`: has any answer moved since the last accepted state (``baseline.json``)?
* `engine`: status, accuracy, verdict and time of every known answer, those of a JSON set (`problem_set`) included;
* `verdict`: planted wrong answers and right ones, and what the verification reports;
* `published`: five published systems, number by number; `basilisk`: the tracked rendezvous in another simulator;
* `lower_bounds`: lower bounds of the cost of rendezvous between random boundary values;
* `rendezvous_minima`: local minima of the published rendezvous.
"""
