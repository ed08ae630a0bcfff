"""The public problem, its loading, steps, states and energies."""
