"""Closed forms and what vmdg computes."""
