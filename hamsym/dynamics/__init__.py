"""Properties of motions: Lyapunov exponents, chaos indicators, monodromy matrices, sections."""
