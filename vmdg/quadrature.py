"""Quadrature degrees, owned in this one place, and compiler flags of the two kinds of kernels."""

from __future__ import annotations


def bulk_degree(cell: str, degree: int) -> int:
    """Degree in the cells for displacement degree k.

    Simplices: 2 (k - 1), exact for a constant A, at least what the load needs. Quadrilaterals and
    hexahedra: 2 k counted per direction, k + 1 points, the fewest that leave no spurious mode.
    """
    if cell in ("triangle", "tetrahedron"):
        return max(2 * (degree - 1), 1)
    return 2 * degree


def facet_degree(degree: int) -> int:
    """Degree on interface facets: products of two displacements are integrated exactly.

    For hexahedra of degree 1 these are the four points of the report's section 7.4.
    """
    return 2 * degree


def load_degree(degree: int) -> int:
    """Degree of loads: displacement times a load that is approximated to degree k + 2.

    Loads that vary in space then add no error of the order of the displacement's.
    """
    return 2 * degree + 2


# gcc's variable tracking under Python's own -g dominates the compile time of large kernels, and
# the default register allocator is slow on the straight-line code of the interface.
JIT_OPTIONS = {
    # How long a rank waits for the one that compiles [s].
    "timeout": 600,
    "cffi_extra_compile_args": [
        "-O1",
        "-march=native",
        "-g0",
        "-fira-region=one",
        "-fira-algorithm=priority",
    ],
}
