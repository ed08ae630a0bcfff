"""Animations of a run: stress on the deformed shape next to a curve, and fields in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from ..base.parallel import gathered, global_max, raise_together
from ..output.history import History
from ..problem.problem import Problem
from ..problem.states import Snapshot
from .stress import Limits, add_colorbar, curve, deformed_ends, stress, stress_means


def animate(
    path: str | Path,
    problem: Problem,
    snapshots: Sequence[Snapshot],
    history: History,
    x: str,
    y: str,
    component: str = "mises",
    magnify: float | Sequence[float] = 1.0,
    limits: Limits | None = None,
    fps: float = 12,
    figsize: tuple[float, float] = (8.0, 3.6),
    dpi: int = 105,
) -> None:
    """Write an animation of stress on the deformed shape and of a curve; collective.

    Take a snapshot in the monitor of every step (``problem.snapshot()``, a copy of the state);
    afterwards the problem is in the last one.

    Args:
        path: A file .gif, or .mp4 if ffmpeg is installed; its folder is created if missing.
        problem: The problem.
        snapshots: The states to show, one for each of the last rows of the history.
        history: The history of the run.
        x: Column along the axis of the curve.
        y: Column that is drawn.
        component: Component of the stress, as for :func:`vmdg.plot.stress`.
        magnify: Factor on the displacement, one for all or one per snapshot.
        limits: Stresses at both ends of the colours [MPa]; None for those of all snapshots except
            the most extreme.
        fps: Frames per second.
        figsize: Size of the figure [inch].
        dpi: Dots per inch.

    Raises:
        ValueError: another suffix, no ffmpeg, no snapshots, or more than rows.
        KeyError: the history has no such column.
    """
    path, rank = Path(path), problem.comm.rank
    _check(problem, path, snapshots, history)
    rows = np.arange(len(history) - len(snapshots), len(history))
    factors = np.broadcast_to(magnify, len(snapshots))
    found, low, high = _ranges(problem, snapshots, factors, component)
    options: dict[str, Any] = {"component": component, "limits": limits or found}
    figure = plt.figure(figsize=figsize)
    solid = problem.mesh.geometry.dim == 3
    grid = figure.add_gridspec(1, 2, width_ratios=(1.5, 1))
    shape = figure.add_subplot(grid[0])
    # The whole curve in grey; a line and a point will follow it.
    ax = curve(history, x, y, figure.add_subplot(grid[1]), origin=True, color="0.85")
    (line,) = ax.plot([], [], color="black")
    (point,) = ax.plot([], [], "o", color="tab:red", clip_on=False, zorder=3)
    if rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
    writer = (FFMpegWriter if path.suffix == ".mp4" else GifWriter)(fps)
    with writer.saving(figure, str(path), dpi) if rank == 0 else nullcontext():
        for row, snapshot, factor in zip(rows, snapshots, factors, strict=True):
            problem.step.return_to(snapshot)
            shape.clear()
            stress(problem, ax=shape, magnify=factor, box=np.stack([low, high]), **options)
            if not solid:
                shape.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            line.set_data(np.r_[0, history[x][: row + 1]], np.r_[0, history[y][: row + 1]])
            point.set_data(history[x][[row]], history[y][[row]])
            if row == rows[0]:
                figure.set_layout_engine("constrained")
                figure.canvas.draw()
                figure.set_layout_engine("none")  # otherwise the axes would move with every number
            for _ in range(1 if row < rows[-1] or rank else round(fps)):
                if rank == 0:
                    writer.grab_frame()
    plt.close(figure)


#: Pixels along the longer side of :func:`film`, and distance of a pixel from the next node up to
#: which it belongs to the body, relative to the largest cell: it is at most 1/sqrt(3) in one.
PIXELS, NEAR = 420, 0.6
#: Part of the way to the middles of their cells by which nodes are moved.
INSIDE = 1e-3


def film(
    path: str | Path,
    problem: Problem,
    fields: Sequence[NDArray[np.float64]],
    titles: Sequence[str],
    label: str,
    most: float | None = None,
    unit: str = "mm",
    fps: float = 12,
    inches: float = 6.0,
) -> None:
    """Write an animation of a field in the plane, such as the speed of a body; collective.

    Every pixel has the value of the next node, so that fields may jump at interfaces.

    Args:
        path: A file .gif; its folder is created if missing.
        problem: A plane problem.
        fields: Values at the nodes of :attr:`.Problem.space`, one array (n,) for each frame, for
            example the norms of ``problem.velocity.x.array.reshape(-1, 2)`` in a monitor.
        titles: One for each frame.
        label: Of the colour bar.
        most: Value at the upper end of the colours, at whose lower end is 0; None for that which
            one point in a thousand exceeds in some frame.
        unit: Of the positions.
        fps: Frames per second.
        inches: Width of the figure.

    Raises:
        ValueError: no field, not as many titles, a body in space, or another suffix.
    """
    path, comm, dim = Path(path), problem.comm, problem.mesh.topology.dim
    message = None
    if path.suffix != ".gif" or dim != 2 or not 0 < len(fields) == len(titles):
        message = (
            f"film: {path} must end in .gif, the body lie in a plane, and {len(fields)} fields "
            f"have one title each, of which there are {len(titles)}"
        )
    raise_together(comm, message)
    cells = np.arange(problem.mesh.topology.index_map(dim).size_local, dtype=np.int32)
    largest = global_max(comm, problem.mesh.h(dim, cells).max(initial=0.0))
    nodes = problem.space.dofmap.list[cells]
    X = gathered(comm, problem.space.tabulate_dof_coordinates()[nodes, :2])
    values = [gathered(comm, field[nodes].ravel()) for field in fields]
    if comm.rank > 0:
        return
    low, sides = X.min(axis=(0, 1)), np.ptp(X, axis=(0, 1))
    # Moved into their cells, nodes of both sides of an interface are at places of their own.
    X += INSIDE * (X.mean(axis=1, keepdims=True) - X)
    counts = np.maximum(np.rint(PIXELS * sides / sides.max()), 1).astype(int)
    x, y = (a + s * (np.arange(n) + 0.5) / n for a, s, n in zip(low, sides, counts, strict=True))
    distance, node = cKDTree(X.reshape(-1, 2)).query(np.stack(np.meshgrid(x, y), axis=-1))
    outside = distance > NEAR * largest
    if most is None:
        most = max(float(np.quantile(field, 0.999)) for field in values)
    # The colour bar takes a quarter of the width, title and labels an inch of the height.
    height = 0.75 * inches * sides[1] / sides[0] + 1.0
    figure, ax = plt.subplots(figsize=(inches, height), layout="constrained")
    box = (low[0], low[0] + sides[0], low[1], low[1] + sides[1])
    picture = np.ma.masked_array(np.max(values, axis=0)[node], outside)
    shown = ax.imshow(picture, "inferno", origin="lower", extent=box, vmin=0, vmax=most)
    add_colorbar(ax, shown, label)
    ax.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = GifWriter(fps)
    writer.colours = "inferno"
    with writer.saving(figure, str(path), 80):
        for field, title in zip(values, titles, strict=True):
            shown.set_data(np.ma.masked_array(field[node], outside))
            ax.set_title(title)
            writer.grab_frame()
    plt.close(figure)


class GifWriter(AbstractMovieWriter):
    """Frames with one palette: colours do not flicker, and unchanged regions take no space."""

    colours = "viridis"

    def setup(self, fig: Figure, outfile: str | Path, dpi: float | None = None) -> None:
        super().setup(fig, outfile, dpi)
        self._pictures: list[Image.Image] = []
        stresses = colormaps[self.colours](np.linspace(0, 1, 212))[:, :3]
        greys = np.repeat(np.linspace(0, 1, 36)[:, None], 3, axis=1)
        reds = np.linspace([1, 1, 1], [0.84, 0.15, 0.16], 8)
        colours = 255 * np.concatenate([stresses, greys, reds])
        self._palette = Image.new("P", (1, 1))
        self._palette.putpalette(colours.round().astype(np.uint8).tobytes())

    def grab_frame(self, **savefig_kwargs: object) -> None:
        buffer = BytesIO()
        self.fig.savefig(buffer, format="rgba", dpi=self.dpi, **savefig_kwargs)
        picture = Image.frombytes("RGBA", self.frame_size, buffer.getvalue()).convert("RGB")
        self._pictures.append(picture.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def finish(self) -> None:
        first, *rest = self._pictures
        duration = round(1000 / self.fps)
        first.save(self.outfile, save_all=True, append_images=rest, duration=duration, loop=0)


def _check(problem: Problem, path: Path, snapshots: Sequence[Snapshot], history: History) -> None:
    message = None
    if path.suffix not in (".gif", ".mp4"):
        message = f"animate: {path} must end in .gif or .mp4"
    elif path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        message = f"animate: {path} needs ffmpeg, which is not installed; write a .gif"
    elif not 0 < len(snapshots) <= len(history):
        message = (
            f"animate: {len(snapshots)} snapshots do not match a history of {len(history)} rows; "
            "take one in the monitor of every step"
        )
    raise_together(problem.comm, message)


def _ranges(
    problem: Problem,
    snapshots: Sequence[Snapshot],
    factors: NDArray[np.float64],
    component: str,
) -> tuple[Limits, NDArray[np.float64], NDArray[np.float64]]:
    """Range of the stress, and least and largest coordinates (3,), over all snapshots and ranks.

    In each snapshot 0.5 % of the cells at both ends are ignored: crack tips are singular.
    """
    stresses, low, high = [], np.full(3, np.inf), np.full(3, -np.inf)
    for snapshot, factor in zip(snapshots, factors, strict=True):
        problem.step.return_to(snapshot)
        stresses.append(np.quantile(stress_means(problem, component), (0.005, 0.995)))
        ends = deformed_ends(problem, factor)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    least, largest = np.min(stresses), np.max(stresses)
    return (min(least, 0.0), largest), low, high
