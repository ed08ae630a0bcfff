"""The ground: compiled kernels, ranks that talk, quadrature degrees, timers."""
