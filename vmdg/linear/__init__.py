"""The linear systems of the tangent.

:mod:`system` has the two ways to solve them: with the assembled tangent by :mod:`ksp`, or condensed
to the interface by :mod:`capacitance`, where :mod:`condensation` finds that cheaper.
:mod:`features` lists what a run uses.
"""
