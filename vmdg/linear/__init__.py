"""The linear systems of the tangent.

:mod:`system` assembles them, :mod:`ksp` solves them. :mod:`features` lists what a run uses.
"""
