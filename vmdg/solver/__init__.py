"""Load steps.

From the run down: :mod:`stepping` (load factors, table, checkpoints), :mod:`path` (how far steps
go, cuts, snaps), :mod:`jump`, :mod:`stepper` (one step), :mod:`newton` with :mod:`control` and
:mod:`criterion`, :mod:`system` with the tangent assembled (:mod:`linear`) or condensed to the
interface (:mod:`capacitance`).
"""
