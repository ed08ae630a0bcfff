"""The linear systems of one tangent, whatever asks for them.

:mod:`system` has the two ways to solve them: the tangent assembled, by :mod:`ksp`, or condensed to
the interface, by :mod:`capacitance`, where :mod:`condensation` finds it cheaper. :mod:`features`
lists what a run uses.
"""
