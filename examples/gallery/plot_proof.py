"""
A proof of the error
====================

A small loss proves nothing about the times between the points of training. A certificate does: it
encloses the exact solution, with every rounding counted, and bounds the error from both sides.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

problem = hamsym.systems.nonlinear_oscillator()
solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
certificate = hamsym.certify(solution)
print(certificate.statement)
print(f"\nproven in {certificate.seconds:.2f} s")

# %%
# The proven bound, the estimate that comes with every solution, and the true error, which is known
# here.

t = np.linspace(*problem.span, 2001)
true = np.linalg.norm(solution(t) - problem.exact(t), axis=1)
estimate = np.linalg.norm(solution.error_estimate(t), axis=1)
figure = Figure(figsize=(8, 4), layout="constrained")
axis = figure.subplots()
axis.semilogy(t, certificate.bound_at(t), color="#d55e00", label="proven upper bound, a window")
axis.semilogy(t[1:], estimate[1:], color="#0072b2", label="estimate")
axis.semilogy(t[1:], true[1:], color="0.3", linestyle=":", label="true error")
axis.axhline(certificate.lower, color="#009e73", linewidth=0.8, label="proven: reached somewhere")
axis.set(xlabel="t", ylabel="2-norm of the error", ylim=(1e-15, None))
axis.legend(loc="lower right")

# %%
# A stranger can check it: ``verify`` proves every number of the certificate again, and refuses
# those of another solution.

hamsym.verify(certificate.to_json(), solution)
other = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-8)
try:
    hamsym.verify(certificate.to_json(), other)
except hamsym.CertificationError as error:
    print(error)

# %%
# Without a neural trajectory: balls that contain the exact states of every start in a ball.

balls = hamsym.enclose("p**2/2 - cos(x)", ["2 +- 1e-6", 0], (0, 20))
for time in (0.0, 10.0, 20.0):
    print(time, balls(time))
