"""Properties of motions: Lyapunov exponents, monodromy matrices, Poincare sections."""
