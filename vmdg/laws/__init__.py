"""Interface laws: traction as a function of the inelastic gap at points, vectorised, numpy only.

>>> import numpy as np
>>> from vmdg.laws import Debonding, Mode
>>> law = Debonding(strength=100.0, critical_gap=0.2)
>>> trial, normal, gap = np.array([[150.0, 0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 2))
>>> update = law.return_map(trial, normal, gap, softening=np.zeros(1), penalty=np.array([3.0e3]))
>>> Mode(update.mode[0]).name, update.softening.round(12), update.traction.round(12)
('TENSION', array([10.]), array([[90.,  0.]]))
"""

from .base import Law, Mode, Update
from .bonded import Bonded
from .compression import SofteningCurve
from .contact import Contact
from .debonding import Debonding
from .exponential import ExponentialDebonding, IntrinsicExponential
from .extrinsic import ExtrinsicLaw, RadialLaw
from .fatigue import FatigueDebonding
from .mixed_mode import MixedModeDebonding
from .trapezoidal import TrapezoidalDebonding

__all__ = [
    "Bonded",
    "Contact",
    "Debonding",
    "ExponentialDebonding",
    "ExtrinsicLaw",
    "FatigueDebonding",
    "IntrinsicExponential",
    "Law",
    "MixedModeDebonding",
    "Mode",
    "RadialLaw",
    "SofteningCurve",
    "TrapezoidalDebonding",
    "Update",
]
