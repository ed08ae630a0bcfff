"""The discrete problem: broken space, loads, supports, residual and tangent."""
