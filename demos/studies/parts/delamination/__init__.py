"""Delamination tests with published numbers, and closed forms beside them."""
