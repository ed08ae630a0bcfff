"""Load steps.

From the run down: :mod:`stepping` (load factors, table, checkpoints), :mod:`path` (how far steps
go, cuts, snaps), :mod:`jump`, :mod:`stepper` (one step), :mod:`newton` with :mod:`control`,
which solves the systems of :mod:`vmdg.linear`.
"""
