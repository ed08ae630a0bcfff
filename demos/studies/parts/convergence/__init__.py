"""Rates against exact solutions."""
