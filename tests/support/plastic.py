"""Materials that flow, and paths of one point."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import vmdg

E, NU = 2000.0, 0.3
ELASTIC = E, NU
VOCE = {"hardening": 40.0, "saturation": 30.0, "exponent": 15.0}
J2 = {
    "perfect": vmdg.J2(E, NU, 20.0),
    "voce": vmdg.J2(E, NU, 20.0, **VOCE),
    "table": vmdg.J2(E, NU, hardening=[(0.0, 20.0), (0.02, 25.0), (0.1, 28.0)]),
    "viscous": vmdg.J2(E, NU, 20.0, hardening=50.0, rate=30.0),
    "kinematic": vmdg.J2(E, NU, 20.0, hardening=30.0, kinematic=100.0),
    "cyclic": vmdg.J2(E, NU, 20.0, kinematic=900.0, recovery=40.0),
    "fading": vmdg.J2(E, NU, 20.0, **VOCE, kinematic=900.0, recovery=40.0, rate=5.0),
}
CONES = {
    "associated": vmdg.DruckerPrager(E, NU, 15.0, 30.0, hardening=60.0),
    "dilatant": vmdg.DruckerPrager(E, NU, 15.0, 35.0, dilatancy=10.0, hardening=60.0),
    "isochoric": vmdg.DruckerPrager(E, NU, 20.0, 25.0, dilatancy=0.0, fit="tension"),
}
MATERIALS = J2 | CONES
FINITE = [name for name, material in MATERIALS.items() if "finite" in material.kinematics]
KINDS = [(name, True) for name in MATERIALS] + [(name, False) for name in FINITE]
DT = 0.2
TENSORS = arrays(float, (3, 3), elements=st.floats(-0.1, 0.1))


def deformed(gradient, small):
    """One point with a displacement gradient."""
    H = np.asarray(gradient)[None]
    return (H + H.transpose(0, 2, 1)) / 2 if small else np.eye(3) + H


def after(name, small, *gradients):
    """The material and its answers along a path of one point."""
    material = MATERIALS[name]
    state, found = material.start(1), []
    for gradient in gradients:
        found.append(material(deformed(gradient, small), state, DT, small))
        state = found[-1].state
    return material, found


def kirchhoff(answer, gradient, small):
    """tau (3, 3) of the one point, at small strain sigma."""
    P = answer.stress[0]
    return P if small else P @ deformed(gradient, small)[0].T
