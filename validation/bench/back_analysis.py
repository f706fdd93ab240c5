"""`python -m validation.bench back_analysis --data DIR`: which bed explains a slide of kilometres (ISeeSnow)?

Twin experiments whose truth a run on finer cells made, and the peak thickness that another code computed.
"""

from pathlib import Path
from typing import Annotated, Any

import tomli_w

from datasets.files import make_folder, read_json, read_toml, write_text
from validation.bench.coverage import Family, held, row, solve_missing, twins_in
from validation.bench.mountain import written_scene
from validation.bench.page import Keep, Many, Out, Row, write_page
from validation.loop.solve import solve
from validation.run_store import kept

DURATION = 110.0
"""Of a slide [s]: it rests after about 75."""
FRICTION = {"name": "solids[0].friction", "initial": 0.4, "lower": 0.3, "upper": 0.5}
TURBULENCE = {"name": "solids[0].turbulence", "initial": 2000.0, "lower": 1000.0, "upper": 4000.0}
OUTLINE = {"kind": "outline", "noise": 10.0}
RASTER = {"kind": "thickness", "cell": 20.0, "noise": 0.2, "length": 40.0}
TWINS: dict[str, tuple[str, list[dict[str, Any]], list[dict[str, Any]]]] = {
    "friction from the outline of the deposit": ("CoulombOnly", [FRICTION], [OUTLINE]),
    "friction from the thickness of the deposit": ("CoulombOnly", [FRICTION], [RASTER]),
    "friction and turbulence from both": ("IdealizedTopo", [FRICTION, TURBULENCE], [OUTLINE, RASTER]),
}
"""What is asked, of which case: unknowns and observations, in metres."""
FINER = 0.5
"""Cells of the truth over those of the inversion."""
CODE = "com1DFA"
"""Whose peaks are explained; its own bed friction stands in the case's parameters."""


def written_problem(
    place: Path, data: Path, cell: float, unknowns: list[dict[str, Any]], observations: list[dict[str, Any]]
) -> Path:
    """A problem file for a case of the comparison on cells of this edge [m], made in the folder `place`."""
    make_folder(place)
    scene = written_scene(data, cell, place)
    write_text(scene, tomli_w.dumps(read_toml(scene) | {"duration": DURATION}))
    measured = all("file" in each for each in observations)
    target = {} if measured else {"target": {"twin": True}}
    table = {"scene": scene.name, "unknowns": unknowns, "observations": observations} | target
    write_text(place / "problem.toml", tomli_w.dumps(table))
    return place / "problem.toml"


def bench(
    *,
    out: Out,
    data: Path,
    keep: Keep = None,
    cell: float = 4.0,
    twins: Annotated[int, Many] = 20,
    jobs: Annotated[int | None, Many] = None,
) -> str:
    """Find the bed of slides of kilometres from their deposits: twin experiments, and another code's result.

    Parameters
    ----------
    data
        Folder of the comparison, with a folder for each case, as of the page `mountain`.
    cell
        Edge of the inversion's cells [m]; the true flows have half of it.
    twins
        Experiments of each kind; the page has all that there are in KEEP.
    jobs
        Processes that solve one each; one per processor unless given.
    """
    with kept(keep) as folder:
        families, asked = dict[Family, Path](), dict[Path, tuple[Family, int, None]]()
        for title, (case, unknowns, observations) in TWINS.items():
            place = folder / title.replace(" ", "-")
            problem = written_problem(place, data / case, cell, unknowns, observations)
            family = Family(title=title, problem=str(problem.absolute()), finer=FINER, twins=twins)
            families[family] = place
            asked |= {(place / f"{number:03d}.json").absolute(): (family, number, None) for number in range(twins)}
        solve_missing(asked, jobs)
        found = {family: twins_in(place) for family, place in families.items()}
        beside = explained(folder / CODE, data, cell)
    every = [twin for some in found.values() for twin in some]
    said = [
        f"In {len(every)} twin experiments on cells of {cell:g} m, whose true flows have cells of {FINER * cell:g} m,"
        f" the 95 % regions contain the true bed in {held(every, 0.95):.0%} of the cases, the 50 % regions in"
        f" {held(every, 0.5):.0%}.",
        f"The peak thickness that {CODE} computed with a friction of 0.4 asks the MPM for {beside['friction']}.",
    ]
    rows = [row(family, some) for family, some in found.items()]
    flags = f" --data DIR --cell {cell:g} --twins {max(map(len, found.values()))}"
    return write_page(out, "back_analysis", said, flags=flags, twins=rows, beside=[beside])


def explained(place: Path, data: Path, cell: float) -> Row:
    """Which friction of the bed explains the peak thickness of another code, with the discrepancy of the model."""
    raster = (data / "CoulombOnly" / f"peak-thickness-{CODE}.tif").absolute()
    observed = {"kind": "thickness", "noise": 0.2, "length": 40.0, "file": str(raster), "peak": True}
    found = solve(str(written_problem(place, data / "CoulombOnly", cell, [FRICTION], [observed])), place / "loop")
    (name,), said = found.unknowns, read_json(place / "loop" / "result.json") or {}
    low, high = found.interval[name]
    return {
        "observation": f"peak thickness of {CODE}",
        "friction": f"{found.unknowns[name]:.3f} ({low:.3f} to {high:.3f})",
        "verdict": found.verdict.value,
        "discrepancy of the model over the other errors": f"{said.get('discrepancy', float('nan')):.2g}",
        "MPM runs": f"{len(found.mpm_runs)}",
        "seconds": f"{found.seconds['total']:.0f}",
    }
