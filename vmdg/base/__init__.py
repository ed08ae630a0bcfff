"""Common tools: compiled kernels, communication between ranks, quadrature degrees, timers."""
