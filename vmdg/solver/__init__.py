"""Load steps.

From the run down: :mod:`stepping` (load factors, table, checkpoints), :mod:`control` (cuts),
:mod:`jump`, :mod:`stepper` (one step), :mod:`iteration` (attempts and criterion), then
:mod:`newton` on the whole problem or :mod:`condensed_newton` on the gaps alone.
"""
