"""Load steps: options, stepping, Newton's method, linear solvers, progress."""
