"""Load steps.

From the run down: :mod:`stepping` (load factors, table, checkpoints), :mod:`path` (how far steps
go, cuts, snaps) with :mod:`limit_point` and :mod:`jump`, :mod:`steps` (one attempt, committed or
undone), :mod:`corrector` (Newton's method) with :mod:`limits`, which solves the systems of
:mod:`vmdg.linear`.
"""
