"""
Compared with integrators
=========================

A solution beside symplectic integrators that use the same symbolic gradients: at several numbers of
steps, and at equal error.
"""

import hamsym

problem = hamsym.systems.henon_heiles()
solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-10)
comparison = hamsym.compare(solution, ["stormer_verlet", "yoshida4", "blanes_moan6", "gauss6"])
print(comparison)

# %%
figure = comparison.plot()

# %%
# ``integrate`` chooses the method and the steps by itself if it is given a tolerance, and estimates
# the error.

trajectory = hamsym.integrate(problem.H, problem.z0, problem.span, tol=1e-9)
print(trajectory.success, trajectory.method, trajectory.steps, trajectory.message)
own = trajectory.plot()
