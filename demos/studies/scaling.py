"""Strong and weak scaling on this machine or a cluster: seconds, messages and memory by ranks.

Every run appends a line to a file in the folder of results and prints the table so far.
The first line of a folder is what the others are compared with: run it on one rank.

Strong: the same mesh on more ranks,       demos/run -n 1 scaling, demos/run -n 2 scaling, ...
Weak: as many cells for every rank,        demos/run -n 1 scaling --weak, ...
Alone: every rank runs the scene of one by itself and waits for none: what the machine allows, for
the table of weak scaling,                 demos/run -n 2 scaling --alone, ...

Two cubes with a bond between them. The model behind the table, for p ranks, N nodes and d
components: every rank computes on N/p nodes and holds copies (ghosts) of those that cells next to a
cut bring with them. A cut of A nodes leaves A of them with the other rank, and the layer of ghost
cells adds A on either side; a cut that follows an interface finds its nodes twice. So, with 4 for 3
along interfaces,

    ghosts of all ranks = 3 * (nodes of cuts),    message = 8 d * ghosts [bytes]

which is sent once in a Krylov iteration, twice in a residual (summed up, and sent back). Here the
box of n x n x 2n cells is halved at the interface, n x n facets, then the halves are. Points of
interfaces, their history and return maps belong to one rank each and send nothing.
"""

from __future__ import annotations

import json
import resource
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers
from parts.options import run
from parts.tables import markdown
from parts.topology import global_max, global_sum

import vmdg

#: Where the time goes: timers of vmdg.
TIMERS = {
    "solve": ("linear solve",),
    "set-up": ("factorize", "coarsen", "set up preconditioner"),
    "tangent": ("assemble tangent",),
    "residual": ("assemble residual",),
    "return map": ("return map",),
    "stabilization": ("stabilization",),
}
#: Of the solves: events of PETSc that end when the other ranks have come as far.
WAITS = ("VecScatterEnd", "VecNorm", "VecMDot", "VecDot")
BOND = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.3)  # MPa, mm
BODY = {"E": 4000.0, "nu": 0.3}  # MPa


@dataclass(frozen=True)
class Row:
    """One run."""

    ranks: int  # Number of processes
    n: int  # Cells along an edge of a cube
    unknowns: int  # Of all ranks
    force: float  # On the top [N]
    rows: int  # Converged steps
    newton: int  # Corrections
    systems: int  # Linear systems, two per correction where damage work is the control parameter
    krylov: int  # Iterations of linear solves
    seconds: float  # Wall time of the steps [s]
    parts: dict[str, float]  # Of it by timer, of the slowest rank [s]
    waiting: float  # Of it in exchanges and sums of vectors, of the rank that waits longest [s]
    ghosts: int  # Nodes that ranks hold for others, of all ranks
    model: int  # What the model of this module says
    facets: float  # Share of the facets of the interface on the rank that has most
    MiB: float  # Largest memory of a rank

    def line(self, first: Row) -> list[str | int | float]:
        """Of the table below ``HEAD``, with the gain over the first row."""
        work = self.unknowns / first.unknowns
        return [
            self.ranks,
            self.unknowns,
            self.rows,
            self.newton,
            self.systems,
            self.krylov,
            self.seconds,
            f"{work * first.seconds / self.seconds:.2f}",
            *self.parts.values(),
            self.waiting,
            f"{self.ghosts} / {self.model}",
            f"{100 * self.facets:.0f} %",
            self.MiB,
            f"{self.force:.10g}",
        ]


HEAD = (
    "ranks",
    "unknowns",
    "rows",
    "Newton",
    "systems",
    "Krylov",
    "seconds",
    "gain",
    *TIMERS,
    "waiting",
    "ghosts / model",
    "most facets",
    "MiB",
    "force [N]",
)


def modelled_ghosts(ranks: int, n: int) -> int:
    """Ghost nodes of all ranks where n x n x 2n cells are halved again and again."""
    sides, parts, ghosts = np.array([n, n, 2 * n], dtype=float), 1, 0.0
    while parts < ranks:
        longest = np.argmax(sides)
        cut = np.prod(np.delete(sides, longest) + 1)
        # The first one is at the interface; the last ones may be of some parts only.
        ghosts += 4 * cut if parts == 1 else 3 * cut * min(parts, ranks - parts)
        sides[longest] /= 2
        parts *= 2
    return round(ghosts)


def build(n: int, comm: MPI.Comm, apart: bool = False) -> tuple[vmdg.Problem, np.ndarray]:
    """The cubes, their load factor the share of the final displacement; facets of the top.

    Opened on one side, pressed and sheared on the other: all branches of the law. Or opened
    everywhere beyond the critical gap, from one side on: the bond is gone in the end.
    """
    mesh, cell_tags, facet_tags = layers("hexahedron", (n, n, 2 * n), (1.0, 1.0, 2.0), n, comm)
    body = vmdg.NeoHookean(**BODY)
    interface = vmdg.Interface(between=(LOWER, UPPER), law=BOND)
    problem = vmdg.Problem(mesh, cell_tags, {LOWER: body, UPPER: body}, [interface])
    top = facet_tags.find(TOP)
    problem.dirichlet(facet_tags.find(BOTTOM), 0.0)
    # mm at x = 0.
    opened = 0.06 if apart else -0.016
    problem.dirichlet(
        top, lambda x, t: t * np.vstack([0.01 + 0 * x[0], 0 * x[0], opened + 0.04 * x[0]])
    )
    return problem, top


def measure(
    n: int,
    comm: MPI.Comm = MPI.COMM_WORLD,
    load: float = 1.0,
    share: float = 0.01,
    apart: bool = False,
    verbose: bool = False,
) -> Row:
    """Two stages to a share of the load; collective.

    Args:
        n: Cells along an edge of a cube.
        share: Of the bond that breaks in a step. Longer steps follow the counts of corrections,
            which differ by one with the linear solver and its ranks, and the force at the end
            follows the steps.
        apart: Open the bond to its end, led by the work on it from the start.
        verbose: Print the residuals of every step.
    """
    problem, top = build(n, comm, apart)
    problem.discretization.compile()
    PETSc.Log.begin()
    comm.barrier()
    before, start = waited(), perf_counter()
    options = vmdg.SolveOptions(
        relative_tolerance=1e-7 if apart else 1e-10,
        max_share=share,
        control="dissipation" if apart else "auto",
        verbose=verbose,
    )
    # Halfway there is an equilibrium to be met exactly, which costs the work's path some others.
    result = vmdg.solve(problem, [load] if apart else [load / 2, load], options)
    comm.barrier()
    seconds, waiting = perf_counter() - start, waited() - before
    measured = {timing.name: timing.seconds for timing in result.timings}
    parts = {
        name: global_max(comm, sum(measured.get(timer, 0.0) for timer in timers))
        for name, timers in TIMERS.items()
    }
    nodes = problem.space.dofmap.index_map
    facets = len(problem.step.activation.facets[0].facets)
    return Row(
        comm.size,
        n,
        3 * nodes.size_global,
        float(problem.reaction(top)[-1]),
        len(result.residuals),
        int(result.history["iterations"].sum()),
        result.counts.solves,
        result.counts.krylov,
        seconds,
        parts,
        global_max(comm, waiting),
        int(global_sum(comm, nodes.num_ghosts)),
        modelled_ghosts(comm.size, n),
        global_max(comm, facets) / n**2,
        global_max(comm, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    )


def waited() -> float:
    """Seconds that this rank has spent in :data:`WAITS` since the log of PETSc began."""
    return sum(PETSc.Log.Event(name).getPerfInfo()["time"] for name in WAITS)


def main(
    cells: int = 18,
    load: float = 1.0,
    share: float = 0.01,
    apart: bool = False,
    weak: bool = False,
    alone: bool = False,
    out: str = "results/scaling",
    fresh: bool = False,
    verbose: bool = False,
) -> list[Row]:
    """Run, and the rows so far; collective.

    Args:
        cells: Cells along an edge of one of the two cubes, on one rank.
        load: Share of the load, which takes all of the bond through its law [-].
        share: Of the bond that breaks in a step at most [-].
        apart: Pull the cubes apart by the work on their bond, which nothing holds in the end.
        weak: Multiply the cells with the number of ranks.
        alone: Run the scene of one rank on every rank; the row is that of the slowest.
        out: Folder of the results.
        fresh: Forget what it has.
        verbose: Print the residuals of every step.
    """
    comm = MPI.COMM_WORLD
    n = round(cells * comm.size ** (1 / 3)) if weak else cells
    row = measure(n, MPI.COMM_SELF if alone else comm, load, share, apart, verbose)
    if alone:
        slowest = max(comm.allgather(row), key=lambda row: row.seconds)
        row = replace(slowest, ranks=comm.size, unknowns=comm.size * row.unknowns)
    rows: list[Row] = []
    if comm.rank == 0:
        file = Path(out) / ("weak.jsonl" if weak or alone else "strong.jsonl")
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "w" if fresh else "a") as lines:
            lines.write(json.dumps(asdict(row)) + "\n")
        rows = [Row(**json.loads(line)) for line in file.read_text().splitlines()]
        text = markdown(HEAD, [row.line(rows[0]) for row in rows])
        file.with_suffix(".md").write_text(text + "\n")
        print(f"{text}\n\nresults are in {out}")
    return comm.bcast(rows)


if __name__ == "__main__":
    run(main)
