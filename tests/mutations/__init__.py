"""The power of the tests: small mistakes in the package, each of which they must notice.

Run ``python -m tests.mutations``, or with the names of rooms. table.toml has the mistakes; those of
the bounds of compiled enclosures are in tests/proof/test_mutations.py.
"""
