"""The nonlinear least-squares solution, its residuals and standard errors."""
