"""Energies as functions of a few invariants, with derivatives by the chain rule.

For energies whose automatic derivatives by F would compile to very large kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import ufl
from ufl.core.expr import Expr
from ufl.variable import Variable


@dataclass(frozen=True)
class Invariants:
    """A strain energy as a function of a few scalars.

    Its derivatives by F follow from scalar ones by the chain rule in two stages, arguments of W by
    invariants and invariants by F. This keeps the kernels of elaborate energies small.
    """

    energy: Expr  # W [MPa], depends on F through the arguments only
    # UFL variables of expressions that depend on F through the invariants only
    arguments: tuple[Variable, ...]
    variables: tuple[Variable, ...]  # I_a, UFL variables of polynomials of the components of F


# Set partitions of one, two and three indices: the terms of repeated chain rules.
_PARTITIONS: dict[int, list[list[tuple[int, ...]]]] = {
    1: [[(0,)]],
    2: [[(0,), (1,)], [(0, 1)]],
    3: [[(0,), (1,), (2,)], [(0, 1), (2,)], [(0, 2), (1,)], [(1, 2), (0,)], [(0, 1, 2)]],
}


class InvariantChain:
    """Derivatives of W by F from those by its invariants I_a, component by component.

    With w_a = dW/dI_a etc., G_a = dI_a/dF and B_a = d2I_a/dF2, all of them scalars: P = w_a G_a, A
    = w_ab G_a (x) G_b + w_a B_a. The form compiler shares equal scalars, but multiplies tensors
    out.
    """

    def __init__(self, energy: Callable[[Expr], Invariants | None], F: Expr):
        self._d = d = F.ufl_shape[0]
        self._F = [ufl.variable(F[i, j]) for i in range(d) for j in range(d)]
        reduced = energy(self._matrix(self._F))
        assert reduced is not None
        self._energy, self._arguments = reduced.energy, reduced.arguments
        self._variables = reduced.variables
        self._derivatives: dict[tuple[int, ...], Expr] = {}
        self._n = range(len(reduced.variables))
        self._G = [[ufl.diff(variable, f) for f in self._F] for variable in reduced.variables]
        self._B = [self._symmetric(gradient) for gradient in self._G]

    def _matrix(self, entries: Sequence) -> Expr:
        d = self._d
        return ufl.as_tensor([[entries[d * i + j] for j in range(d)] for i in range(d)])

    def _symmetric(self, gradient: Sequence[Expr]) -> list[list[Expr]]:
        """Second derivatives from first ones, each differentiated once."""
        n = len(gradient)
        upper = [[ufl.diff(gradient[p], self._F[q]) for q in range(p, n)] for p in range(n)]
        return [[upper[min(p, q)][abs(q - p)] for q in range(n)] for p in range(n)]

    def _w(self, *order: int) -> Expr:
        """Derivative of W by up to three invariants, through its arguments."""
        # Mixed derivatives are taken in one order, so that equal ones share an expression.
        order = tuple(sorted(order))
        if order not in self._derivatives:
            n = len(self._arguments)
            result = 0
            # Every partition of the invariants into blocks, one argument for each block.
            for partition in _PARTITIONS[len(order)]:
                for arguments in product(range(n), repeat=len(partition)):
                    term = self._differentiate(self._energy, self._arguments, sorted(arguments))
                    for argument, block in zip(arguments, partition, strict=True):
                        indices = [order[position] for position in block]
                        inner = self._arguments[argument]
                        term *= self._differentiate(inner, self._variables, indices)
                    result += term
            self._derivatives[order] = result
        return self._derivatives[order]

    @staticmethod
    def _differentiate(f: Expr, variables: Sequence[Expr], order: Sequence[int]) -> Expr:
        for a in order:
            f = ufl.diff(f, variables[a])
        return f

    def stress(self) -> Expr:
        return self._matrix(
            [sum(self._w(a) * self._G[a][p] for a in self._n) for p in range(self._d**2)]
        )

    def moduli(self, weights: Sequence[Expr | int]) -> Expr:
        """sum_p weights_p dP_p/dF, (d, d), p the row-wise number of a component of P."""
        g, dg = self._contract(weights)
        row = [sum(self._w(a, b) * g[a] for a in self._n) for b in self._n]
        return self._matrix(
            [
                sum(row[a] * self._G[a][q] + self._w(a) * dg[a][q] for a in self._n)
                for q in range(self._d**2)
            ]
        )

    def third_derivative(self, weights: Sequence[Expr]) -> Expr:
        """sum_p weights_p d2P_p/dF2, (d, d, d, d)."""
        n = self._n
        g, dg = self._contract(weights)
        d2g = [self._symmetric(gradient) for gradient in dg]
        row = [sum(self._w(a, b) * g[b] for b in n) for a in n]
        square = [[sum(self._w(a, b, c) * g[c] for c in n) for b in n] for a in n]
        # Everything that multiplies G_a(q) from the right, once for every component r.
        right = [
            [
                sum(square[a][b] * self._G[b][r] + self._w(a, b) * dg[b][r] for b in n)
                for r in range(self._d**2)
            ]
            for a in n
        ]
        left = [
            [sum(self._w(a, b) * self._G[b][r] for b in n) for r in range(self._d**2)] for a in n
        ]

        def entry(q: int, r: int) -> Expr:
            q, r = min(q, r), max(q, r)
            return sum(
                self._G[a][q] * right[a][r]
                + dg[a][q] * left[a][r]
                + row[a] * self._B[a][q][r]
                + self._w(a) * d2g[a][q][r]
                for a in n
            )

        components = range(self._d**2)
        return self._matrix([self._matrix([entry(q, r) for r in components]) for q in components])

    def _contract(self, weights: Sequence[Expr | int]) -> tuple[list[Expr], list[list[Expr]]]:
        """sum_p weights_p G_a(p) and its derivative by F."""

        def dot(values: Sequence[Expr]) -> Expr:
            return sum(w * value for w, value in zip(weights, values, strict=True) if w != 0)

        return [dot(G) for G in self._G], [[dot(row) for row in B] for B in self._B]
