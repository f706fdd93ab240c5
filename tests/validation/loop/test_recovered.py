"""Two baffles and three layers of small scenes, found by the MPM itself."""

from pathlib import Path

import pytest

from inverse.answer import Verdict
from inverse.result import Result
from validation.loop.solve import solve

BOX = """
floor_friction = 0.4
step_fraction = 0.9
domain = { size = [1.0, 0.3], cell = 0.02 }
material = { friction_deg = 30.0, young = 5.0e5 }
"""
LAYERS = (0.9, 0.6, 0.3)
"""Velocity of each [m/s]."""
BAFFLES = {"baffles[0].x": 0.42, "baffles[1].x": 0.68}
"""Centre of each [m]."""


def recovered(folder: Path, scene: str, unknowns: str, rest: str) -> Result:
    """What the loop finds of a twin experiment."""
    (folder / "scene.toml").write_text(scene)
    (folder / "problem.toml").write_text('scene = "scene.toml"\nsurrogate = "none"\n' + unknowns + rest)
    result = solve(str(folder / "problem.toml"))
    assert result.verdict is Verdict.CONFIRMED
    truth = result.target.truth
    for name, value in truth.items():
        assert abs(result.unknowns[name] - value) < 2.0 * result.certainty[name], name
    return result


@pytest.mark.slow
def test_three_layers_have_their_velocities(tmp_path: Path) -> None:
    masses = "".join(
        f"[[masses]]\nlower = [0.0, {0.06 * row:g}]\nsize = [0.3, 0.06]\nvelocity = [{speed}, 0.0]\n"
        for row, speed in enumerate(LAYERS)
    )
    unknowns = "".join(
        f'[[unknowns]]\nname = "masses[{row}].velocity_x"\ninitial = 0.0\nlower = -0.5\nupper = 1.5\n'
        for row in range(3)
    )
    observed = '[[observations]]\nkind = "deposit"\n[target]\ntwin = true\n'
    result = recovered(tmp_path, "duration = 0.2\n" + BOX + masses, unknowns, observed)
    assert max(result.certainty.values()) < 0.2


@pytest.mark.slow
def test_two_baffles_have_their_places(tmp_path: Path) -> None:
    body = "[[masses]]\nlower = [0.0, 0.0]\nsize = [0.2, 0.2]\nvelocity = [2.0, 0.0]\n"
    baffles = "".join(f"[[baffles]]\nlower = [{x}, 0.0]\nsize = [0.04, 0.05]\n" for x in (0.36, 0.66))
    unknowns = "".join(
        f'[[unknowns]]\nname = "{name}"\ninitial = {middle}\nlower = {middle - 0.08:g}\nupper = {middle + 0.08:g}\n'
        for name, middle in zip(BAFFLES, (0.38, 0.68), strict=True)
    )
    truth = ", ".join(f'"{name}" = {x}' for name, x in BAFFLES.items())
    observed = f'[[observations]]\nkind = "profile"\n[target]\ntwin = true\ntruth = {{ {truth} }}\n'
    result = recovered(tmp_path, "duration = 0.6\n" + BOX + body + baffles, unknowns, observed)
    assert max(result.certainty.values()) < 0.04
