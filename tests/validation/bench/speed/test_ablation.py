"""`python -m validation.bench ablation`: trainings that are not repeated, scores in a table with its conclusion."""

import subprocess
from pathlib import Path

import pytest

from gns.score import Score
from validation.bench.speed import ablation
from validation.bench.speed.ablation import VARIANTS, Variant, VariantScore


def scored(change: str, front: float) -> VariantScore:
    score = Score(
        name="flow",
        released=True,
        friction_deg=30.0,
        front_error=-front,
        profile_error=2.0 * front,
        rmse=(0.01, 0.02, 0.03),
        kinetic_error=0.1,
        seconds=0.5,
    )
    return VariantScore(change=change, parameters=178_000, updates=860, scores=(score,))


def test_every_variant_is_trained_once_and_compared_with_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[list[str]] = []

    class Done:
        returncode = 0

    def run(arguments: list[str], **_: object) -> Done:
        trained.append(arguments)
        folder = Path(arguments[arguments.index("--out") + 1])
        folder.mkdir()
        (folder / "scores.md").touch()
        return Done()

    errors = {each.change: 0.06 + 0.01 * number for number, each in enumerate(VARIANTS)}
    errors[VARIANTS[4].change] = 0.05

    def score(variant: Variant, folders: list[Path], folder: Path) -> VariantScore:
        return scored(variant.change, errors[variant.change])

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(ablation, "score", score)
    for _ in range(2):
        said = ablation.bench(tmp_path, quick=False, keep=tmp_path)
    assert len(trained) == len(VARIANTS)
    assert "--width" in trained[3]
    assert f"1 of {len(VARIANTS) - 1} changes lower it. The lowest is 5.0% (2 layers), the highest 20.0%" in said
    text = (tmp_path / "ablation.md").read_text()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["2 layers", "178 K", "860", "5.0%", "5.0%", "10.0%", "10.0%", "1.0", "4.0", "9.0"] in [
        row[:10] for row in cells
    ]
