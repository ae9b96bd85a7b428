"""Published systems, number by number: ``python -m benchmarks.validation.published``.

``SYSTEM.json`` holds what is known, ``SYSTEM.py`` computes the values, `comparison` joins them, `runner` prints.
"""
