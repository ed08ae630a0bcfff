"""Numbers of the gallery, to show that a change of the code changes no result.

    demos/run .ci/gallery.py record FOLDER [SCENE...]     every scene at its defaults, one file each
    demos/run .ci/gallery.py compare BEFORE AFTER         one table: iterations, failures, values
    demos/run .ci/gallery.py record --fine FINE [SCENE...]   with steps of 0.5 % of the bonds
    demos/run .ci/gallery.py peaks FOLDER FINE            one table: largest forces and stresses

``OTHER/demos/run .ci/gallery.py record FOLDER`` records the checkout OTHER. What ``vmdg.solve``
returns in a scene is recorded: all columns of its history, and its failures.
"""

from __future__ import annotations

import argparse
import inspect
import json
import runpy
import subprocess
import sys
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

import vmdg

DEMOS = Path(vmdg.__file__).resolve().parent.parent / "demos"

_CELL = "--element-size 0.05 --critical-gap 0.01"
_MANY = "--fibres 5 --cell triangle --activate on-demand"
SCENES = {
    "patch_tension": "patch_tension --no-plot",
    "patch_shear": "patch_shear --no-plot",
    "load_cycle": "load_cycle",
    "tutorial": "tutorial",
    "tutorial_law": "tutorial_law",
    "tutorial_material": "tutorial_material",
    "tutorial_laminate": "tutorial_laminate",
    "two_inclusions": "two_inclusions --no-plot",
    "weak_links": "weak_links",
    "buckling": "buckling",
    "fibre_cell": "fibre_cell",
    "polycrystal": "polycrystal --no-trace --steps 10",
    "fibre_matrix": "fibre_matrix",
    "fibre_film": f"fibre_matrix {_CELL} --animate",
    "fibres_five": f"fibre_matrix {_CELL} {_MANY}",
    "tearing": "tearing",
    "tearing_ogden": "tearing --material ogden",
    "pushout": "pushout",
    "peers": "others --alone",
    "verification": "verification --no-plot",
    "pushout_solid": "pushout --solid",
}


def record(folder: Path, scenes: list[str], share: float) -> None:
    """Run scenes, each in a process of its own; ``share`` is the largest ``max_share`` of a run."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in scenes or SCENES:
        demo, *options = SCENES[name].split()
        file, out = folder / f"{name}.json", folder / name
        chosen = str(file), str(share), demo, *options
        program = [sys.executable, __file__, "one", *chosen, "--out", str(out)]
        with open(folder / f"{name}.log", "w") as log:
            code = subprocess.run(program, stdout=log, stderr=log, check=False).returncode
        print(f"{name}: {'done' if code == 0 else f'exit code {code}, see {log.name}'}", flush=True)


def run_one(file: Path, share: float, demo: str, options: list[str]) -> None:
    """Run a demo in this process and write what its calls of ``vmdg.solve`` gave."""
    solve, runs, signature = vmdg.solve, [], inspect.signature(vmdg.solve)

    def recorded(*arguments: Any, **others: Any) -> vmdg.Result:
        result, before = None, process_time()
        given = signature.bind(*arguments, **others)
        old = given.arguments.get("options") or vmdg.SolveOptions()
        finely = {"max_share": min(old.max_share, share), "control": "dissipation"}
        given.arguments["options"] = replace(old, **finely) if share < 1 else old
        try:
            result = solve(*given.args, **given.kwargs)
        except vmdg.StepFailure as failure:
            result = failure.result
            raise
        finally:
            if result is not None:
                rows = [
                    {k: np.asarray(v).tolist() for k, v in r.items()} for r in result.history.rows
                ]
                runs.append(
                    {
                        "rows": rows,
                        "failures": [str(why) for _, why in result.failures],
                        "counts": asdict(result.counts),
                        "imbalance": _imbalance(arguments[0], result),
                        "seconds": process_time() - before,
                    }
                )
        return result

    vmdg.solve = recorded
    sys.argv = [demo, *options]
    places = (DEMOS / f"{demo}.py", DEMOS / "studies" / f"{demo}.py")
    script = next(place for place in places if place.is_file())
    sys.path.insert(0, str(script.parent))
    start = process_time()
    runpy.run_path(str(script), run_name="__main__")
    file.write_text(json.dumps({"seconds": process_time() - start, "calls": runs}))


def _imbalance(problem: vmdg.Problem, result: vmdg.Result) -> float:
    """Energy that is not accounted for, relative to what the bodies store and have dissipated."""
    energy = problem.energy()
    stored = [row["stored"] for row in result.history.rows if "stored" in row]
    size = max(energy.dissipated + energy.stored, *stored, abs(energy.external), 1e-300)
    return energy.imbalance / size


def compare(before: Path, after: Path) -> None:
    """Print a line a scene."""
    print(
        "| scene | rows | iterations | failed, before and after | Krylov | residuals | solves "
        "| seconds | imbalance | difference | in |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    names = sorted(file.name for file in before.glob("*.json") if (after / file.name).is_file())
    for name in names:
        old, new = (json.loads((folder / name).read_text())["calls"] for folder in (before, after))
        rows = [[row for call in calls for row in call["rows"]] for calls in (old, new)]
        iterations = [[row["iterations"] for row in table] for table in rows]
        krylov = [sum(row.get("krylov", 0) for row in table) for table in rows]
        failed = [sum(len(call["failures"]) for call in calls) for calls in (old, new)]
        same = "=" if iterations[0] == iterations[1] else f"{sum(iterations[0])} before,"
        shapes = [[len(call["rows"]) for call in calls] for calls in (old, new)]
        residuals, solves = (
            ", ".join(str(sum(call["counts"][what] for call in calls)) for calls in (old, new))
            for what in ("residuals", "solves")
        )
        seconds = ", ".join(f"{sum(c['seconds'] for c in calls):.1f}" for calls in (old, new))
        lost = ", ".join(f"{max(abs(c['imbalance']) for c in calls):.0e}" for calls in (old, new))
        worst, column = difference(old, new) if shapes[0] == shapes[1] else (np.inf, "rows")
        print(
            f"| {Path(name).stem} | {len(rows[1])} | {same} {sum(iterations[1])} "
            f"| {failed[0]}, {failed[1]} | {krylov[0]}, {krylov[1]} | {residuals} | {solves} "
            f"| {seconds} | {lost} | {worst:.1e} | {column} |"
        )


def peaks(folder: Path, fine: Path) -> None:
    """Print the largest values of columns that are forces or stresses, and their differences."""
    print("| scene | run | column | rows, finely | largest | finely | difference |")
    print("|---|---|---|---|---|---|---|")
    for name in sorted(file.name for file in fine.glob("*.json") if (folder / file.name).is_file()):
        calls = [json.loads((where / name).read_text())["calls"] for where in (folder, fine)]
        for n, (one, other) in enumerate(zip(*calls, strict=True)):
            for column in one["rows"][-1]:
                if not any(word in column for word in ("force", "stress", "traction")):
                    continue
                found = [[row.get(column, 0.0) for row in run["rows"]] for run in (one, other)]
                a, b = (float(np.abs(values).max()) for values in found)
                counts = ", ".join(str(len(values)) for values in found)
                change = f"{100 * (a / b - 1):+.2f} %" if b else "0"
                values = f"{counts} | {a:.6g} | {b:.6g} | {change}"
                print(f"| {Path(name).stem} | {n} | {column} | {values} |")


def difference(old: list[dict], new: list[dict]) -> tuple[float, str]:
    """Largest difference of a column relative to its largest value, and its name.

    Residuals and imbalances are differences of large numbers and left out, as are seconds;
    Krylov iterations are counted.
    """
    worst, where = 0.0, ""
    for first, second in zip(old, new, strict=True):
        names = dict.fromkeys(chain.from_iterable(row for row in first["rows"]))
        for name in names:
            if name in ("residual", "imbalance", "krylov") or "second" in name:
                continue
            a, b = (
                np.concatenate([np.ravel(row.get(name, np.nan)) for row in call["rows"]])
                for call in (first, second)
            )
            if a.dtype.kind not in "fib":
                change = 0.0 if np.array_equal(a, b) else np.inf
            else:
                scale = np.nanmax(np.abs(a), initial=0.0) or 1.0
                change = float(np.nanmax(np.abs(a - b), initial=0.0)) / scale
            if change > worst:
                worst, where = change, name
    return worst, where


def main() -> None:
    """The command line."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = command.add_subparsers(dest="command", required=True)
    recording = parts.add_parser("record", help="run scenes and write their numbers")
    recording.add_argument("folder", type=Path)
    recording.add_argument("scenes", nargs="*", metavar="SCENE", help=", ".join(SCENES))
    recording.add_argument("--fine", action="store_true", help="steps of 0.5 %% of the bonds")
    for name, text in (
        ("compare", "compare two folders"),
        ("peaks", "largest forces of two folders"),
    ):
        comparing = parts.add_parser(name, help=text)
        comparing.add_argument("before", type=Path)
        comparing.add_argument("after", type=Path)
    chosen = command.parse_args()
    if chosen.command == "record":
        record(chosen.folder, chosen.scenes, 0.005 if chosen.fine else 1.0)
    else:
        {"compare": compare, "peaks": peaks}[chosen.command](chosen.before, chosen.after)


if __name__ == "__main__":
    if sys.argv[1:2] == ["one"]:
        run_one(Path(sys.argv[2]), float(sys.argv[3]), sys.argv[4], sys.argv[5:])
    else:
        main()
