"""The public problem, its states and energies, and input checks."""
