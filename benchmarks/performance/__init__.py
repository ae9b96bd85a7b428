"""How fast, how large, how accurate: ``python -m benchmarks.performance.NAME`` prints a table and writes JSON.

* `scale`: time and memory by size of the mesh;
* `certified`: time to a verified answer; `resolve`: warm starts;
* `closed_loop`: Monte Carlo runs per second; `profile`: other programs;
* `page`: writes the tables of docs/benchmarks.md.
"""
