"""What a user sees: the problem, its states and energies, and errors at the door."""
