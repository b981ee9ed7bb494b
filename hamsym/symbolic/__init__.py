"""Expressions to equations: pairs of variables, checks, gradient and Hessian of H."""
