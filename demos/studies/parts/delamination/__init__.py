"""Delamination tests against published numbers and closed forms."""
