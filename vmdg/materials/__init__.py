"""Materials with a history, evaluated at the points of the bodies in numpy."""
