"""The bonded form on random cells."""
