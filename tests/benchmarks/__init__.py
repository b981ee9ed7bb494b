"""Benchmarks: each measures one thing, and its results are one section of results.json.

``python -m tests.benchmarks`` runs them and ``python -m tests.benchmarks.tables`` writes the tables
of examples/guide/benchmarks.md from the results. :mod:`tests.benchmarks.registry` lists the
benchmarks.
"""
