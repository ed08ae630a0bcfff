"""Plastic bodies with interfaces: published values, closed forms, and what vmdg computes."""
