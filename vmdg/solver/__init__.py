"""The solver of load steps.

From the run down: :mod:`stepping` (load factors, history, checkpoints), :mod:`path` (step size,
cuts, snaps) with :mod:`limit_point` and :mod:`jump`, :mod:`steps` (one attempt, committed or
cancelled), :mod:`corrector` (Newton's method) with :mod:`limits`, which solves the systems of
:mod:`vmdg.linear`.
"""
