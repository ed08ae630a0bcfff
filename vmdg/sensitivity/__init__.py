"""Derivatives of runs by parameters of laws and bodies."""
