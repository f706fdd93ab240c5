"""`report.md` and `result.plot()` of a loop, for every kind of outcome."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from matplotlib.image import imread

from datasets.exchange.vtk import SERIES
from inverse.report import pictures
from inverse.settings import TargetSettings
from tests.validation.loop.flows import Case, Folded, layers, wedge
from validation.loop import report
from validation.loop.result import Result

KINDS: dict[str, Callable[[Path], Case]] = {
    "front": lambda folder: wedge(folder, scatter=0.001),
    "number": lambda folder: wedge(folder, target=TargetSettings(value=0.79), kind="runout", scatter=0.001),
    "layers": lambda folder: layers(folder, count=6, scatter=0.002),
    "toe": lambda folder: layers(folder, count=3, kind="toe", scatter=0.002),
    "design": lambda folder: layers(
        folder, count=3, kind="passed", target=TargetSettings(minimise=True), scatter=0.002
    ),
    "unreachable": lambda folder: wedge(folder, target=TargetSettings(value=0.05), scatter=0.001),
    "folded": lambda folder: wedge(folder, truth=22.0, mpm=Folded(scatter=0.002)),
}


@pytest.fixture(scope="module", params=KINDS)
def outcome(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Result, Path]:
    """The kind, the result and the folder with its report."""
    folder = tmp_path_factory.mktemp(request.param)
    result = KINDS[request.param](folder).solve(folder)
    patch = pytest.MonkeyPatch()
    # What is drawn does not depend on the resolution, the seconds do.
    patch.setattr(pictures, "RESOLUTION", 40)
    report.write(result, folder)
    patch.undo()
    return request.param, result, folder


def test_a_report_begins_with_its_conclusion_and_shows_every_parameter(outcome: tuple[str, Result, Path]) -> None:
    kind, result, folder = outcome
    text = (folder / "report.md").read_text()
    title, sentences, *_ = text.split("\n\n")
    assert title == f"# {result.problem.name}: {result.verdict}"
    assert 3 <= len(sentences.splitlines()) <= 5
    assert ("The MPM confirms" in sentences) == (result.verdict == "confirmed")
    for each in result.problem.parameters:
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{each.name}`") and "**" in line]
        assert each.kind.text(result.unknowns[each.name]) in row
        if result.certainty:
            assert f"± {each.kind.text(result.certainty[each.name])}" in row
        if result.target.truth:
            assert each.kind.text(result.target.truth[each.name]) in row
    expected = {"deposit.png", "predictive.png", "posterior.png", "waves.png"}
    expected |= {"unknowns.png"} if len(result.unknowns) > 2 else set()
    assert {path.name for path in folder.glob("*.png")} == expected
    for picture in expected:
        assert f"]({picture})" in text
        assert imread(folder / picture)[..., :3].std() > 0.01
    assert ("may move by" in text) == (kind == "design")
    assert ("- **Not identifiable**" in text) == (kind == "toe")
    assert ("## Every separate answer" in text) == (kind == "folded")
    assert ("## What a further measurement would decide" in text) == (kind in ("toe", "folded"))
    assert "nan" not in text
    assert str(result.verdict) in report.summary(result)


def test_the_figure_has_deposits_and_parameters(outcome: tuple[str, Result, Path]) -> None:
    _, result, _ = outcome
    figure = result.plot()
    above, below = figure.axes
    assert len(above.collections) == 1 + (result.target.deposit is not None)
    assert [label.get_text() for label in below.get_yticklabels()] == result.problem.names
    figure.canvas.draw()
    plt.close(figure)


def test_the_final_run_for_paraview(tmp_path: Path) -> None:
    result = wedge(tmp_path).solve(tmp_path)
    report.append_final_run(result, tmp_path, vtk=True, movie=False)
    assert f"`vtk/{SERIES}`" in (tmp_path / "report.md").read_text()
    assert (tmp_path / "vtk" / SERIES).exists()
