"""`python -m validation.bench efficiency` on forward models that are formulas: searches, gradients, costs, page."""

import dataclasses
import math
import os
import signal
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.particles import particle_count
from inverse.observations import build
from inverse.problem import Problem, read_problem
from inverse.settings import Method
from inverse.target import Target
from validation.bench.efficiency import bench, columns, gradients, records
from validation.bench.efficiency import page as efficiency_page
from validation.bench.efficiency.columns import Size, Task, Usage, Work
from validation.bench.efficiency.findings import (
    best_of,
    conclusion,
    crossing,
    particles_cost,
    particles_memory,
    problems_best,
    surrogate_use,
    unknowns_cosine,
    unknowns_cost,
)
from validation.bench.efficiency.methods import PAPER_STEP_DEG, ForwardModel, GradientBy, methods, with_method
from validation.bench.efficiency.records import (
    AD,
    AD_LONG,
    ADJOINT,
    ADJOINT_MEAN,
    FD_GNS,
    FD_JITTER,
    FD_MPM,
    CheckedLoss,
    Cost,
    Gradient,
    MethodResult,
    Origin,
    OverParticles,
    OverUnknowns,
    Parts,
    ProblemResult,
)
from validation.bench.efficiency.search import Iterate, Models, improvements, search, thinned
from validation.bench.paper import read_paper
from validation.report import plots
from validation.report.measuring import isolated

TRUTH = 24.0
ORIGIN = Origin(machine="a machine", date="2000-01-01", key="k")


class Formula:
    """A front [m] that falls with the angle [deg]; one that is off by `offset` [m]."""

    def __init__(self, offset: float = 0.0, seconds: float = 0.0) -> None:
        self.offset, self.seconds, self.runs, self.time = offset, seconds, 0, 0.0

    def predict(self, unknowns: Tensor) -> Tensor:
        self.runs += 1
        self.time += self.seconds
        return (1.2 - 0.02 * unknowns[0] + 0.00015 * unknowns[0] ** 2 + self.offset).reshape(1)

    def observe(self, unknowns: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        return [self.predict(torch.from_numpy(values)).numpy() for values in unknowns]


@pytest.fixture
def problem() -> Problem:
    return read_problem("friction-tall-42")


def searched(
    problem: Problem, name: str, limit: float = 100.0, offset: float = 0.0, *, by_secants: bool = False
) -> tuple[MethodResult, Formula]:
    gns, mpm = Formula(offset, seconds=1.0), Formula(seconds=1.0)
    (values,) = Formula().observe([np.array([TRUTH])])
    observation = build(problem.observation, problem.scene)
    models = Models(
        target=Target(observation=observation, values=values, front=float(values[0]), truth={"friction_deg": TRUTH}),
        components=1,
        gns=gns,
        gns_target=values,
        mpm=mpm,
        adjoint=mpm,
        check=Formula(),
    )
    method = next(each for each in methods(problem, read_paper()) if each.name == name)
    if by_secants:
        method = dataclasses.replace(
            method, gradient=GradientBy.SECANTS, problem=with_method(method.problem, Method.SECANTS)
        )
    return search(method, models, limit, clock=lambda: gns.time + mpm.time), mpm


def test_every_problem_has_every_method(problem: Problem) -> None:
    found = {each.name: each for each in methods(problem, read_paper())}
    assert found["AD, GNS"].paper == 107.0
    fine = found[f"differences of {PAPER_STEP_DEG:g} deg, MPM"]
    assert fine.paper == 16157.0
    assert fine.problem.steps == pytest.approx([0.05])
    assert found["differences of 2 deg, MPM"].problem.bounds == [(14.0, 50.0)]
    for name in ("velocity-layers-10", "baffles-2", "cohesion-friction"):
        other = read_problem(name)
        rows = methods(other, read_paper())
        of_one = {GradientBy.AD: ForwardModel.GNS} | dict.fromkeys(
            (GradientBy.ADJOINT, GradientBy.SECANTS), ForwardModel.MPM
        )
        assert {(each.model, each.gradient) for each in rows} == {
            (model, by) for model in ForwardModel for by in GradientBy if of_one.get(by, model) is model
        }
        assert {each.optimiser for each in rows if each.gradient is GradientBy.ADJOINT} == {"lbfgs-b"}
        assert any(each.optimiser == "gauss-newton" and each.model is ForwardModel.MPM for each in rows)
        assert all(np.array_equal(each.problem.initial, other.initial) and each.paper is None for each in rows)


def test_many_unknowns_have_one_search_by_differences_of_each_model() -> None:
    problem = gradients.hundred_problem()
    assert len(problem.parameters) == 100
    names = [each.name for each in methods(problem, read_paper())]
    assert names == [
        "AD, GNS",
        "differences of 0.15 m/s, GNS",
        "differences of 0.15 m/s, MPM",
        "adjoint, MPM",
        "secants, MPM",
        "Optuna, MPM",
    ]


@pytest.mark.parametrize("name", ["adjoint, MPM", "secants, MPM"])
def test_the_mpm_is_searched_without_differences(problem: Problem, name: str) -> None:
    if name == "secants, MPM":
        # One unknown has no such row: with a single number the secant is L-BFGS-B's first guess already.
        assert name not in [each.name for each in methods(problem, read_paper())]
        row, mpm = searched(problem, "adjoint, MPM", by_secants=True)
        assert row.sample == 1 + 6 + 1
    else:
        row, mpm = searched(problem, name)
        assert row.sample == 0
    assert row.mpm_runs == row.sample + row.iterations == mpm.runs
    assert row.error["deg"] < 0.2


def test_a_search_counts_its_runs_and_its_answer_is_checked(problem: Problem) -> None:
    row, mpm = searched(problem, "differences of 2 deg, MPM")
    assert row.mpm_runs == 3 * row.iterations == mpm.runs
    assert row.error["deg"] < 0.2
    assert row.ended == "target met"
    assert row.seconds == mpm.time
    # A surrogate that is 50 mm off meets the target by its own loss; the check shows the difference.
    row, mpm = searched(problem, "AD, GNS", offset=0.05)
    assert (row.mpm_runs, mpm.runs) == (0, 0)
    assert row.ended == "target met"
    assert row.loss == pytest.approx(0.05**2, rel=0.05)
    assert row.error["deg"] > 3.0
    assert row.seconds == row.iterations


@pytest.mark.parametrize(
    ("name", "limit", "iterations"),
    [("Optuna, GNS", 6.0, 6), ("differences of 2 deg, GNS", 7.0, 2), ("differences of 2 deg, GNS", 0.1, 1)],
)
def test_a_search_ends_in_time_after_one_iteration_or_more(
    problem: Problem, name: str, limit: float, iterations: int
) -> None:
    row, _ = searched(problem, name, limit=limit)
    assert row.iterations == iterations
    assert row.ended == "out of time"
    assert row.seconds <= limit or iterations == 1


def test_the_curve_is_of_improvements() -> None:
    losses = [math.nan, 4.0, 5.0, 2.0, math.nan, 2.5, 1.0]
    iterates = [
        Iterate(seconds=1.0 + number, unknowns=np.zeros(1), loss=value, forward_s=1.0, backward_s=0.0)
        for number, value in enumerate(losses)
    ]
    found = improvements(iterates)
    assert [each.loss for each in found] == [4.0, 2.0, 1.0]
    assert [each.loss for each in thinned(found, 2)] == [4.0, 1.0]
    assert len(improvements(iterates[:1])) == 1


@pytest.mark.parametrize("cut", gradients.CUTS)
def test_every_cut_is_of_the_same_particles(cut: tuple[int, int]) -> None:
    scene = gradients.blocks(*cut)
    assert particle_count(scene) == 3_920
    assert len(scene.masses) == cut[0] * cut[1]
    ends = np.array([np.add(mass.lower, mass.size) for mass in scene.masses]).max(axis=0)
    assert ends == pytest.approx([0.35, 0.28])
    assert np.mean([(mass.velocity or (0.0,))[0] for mass in scene.masses]) == pytest.approx(0.825, abs=0.02)


class Linear:
    """Numbers that are a matrix times the unknowns."""

    def __init__(self, matrix: NDArray[np.float64]) -> None:
        self.matrix, self.runs = matrix, 0

    def predict(self, unknowns: Tensor) -> Tensor:
        return torch.from_numpy(self.matrix) @ unknowns

    def observe(self, unknowns: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        self.runs += len(unknowns)
        return [self.matrix @ values for values in unknowns]


@pytest.mark.parametrize("cut", [(1, 2), (3, 2)])
def test_gradients_are_compared_with_the_mpm_s(cut: tuple[int, int]) -> None:
    problem = gradients.blocks_problem(*cut)
    count = len(problem.parameters)
    matrix = np.random.default_rng(0).normal(size=(2 * count, count))
    target, mpm = np.ones(2 * count), Linear(matrix)

    def compared(gns: NDArray[np.float64]) -> dict[str, Gradient]:
        models = gradients.Models(
            gns=Linear(gns),
            gns_target=target,
            mpm=[mpm, Linear(matrix)],
            adjoint=[Linear(matrix), Linear(gns)],
            target=target,
            components=2,
        )
        return {each.method: each for each in gradients.gradients(problem, models, most=4)}

    same = compared(matrix)
    assert mpm.runs == 1 + 2 * min(count, 4)
    for name, each in same.items():
        assert each.extrapolated == (name not in (AD, ADJOINT, ADJOINT_MEAN) and count > 4)
        assert each.cosine == pytest.approx(1.0)
        assert each.error is not None
        assert each.error < 1e-9
    # The residual changes with the matrix, and so does the gradient.
    other = compared(-matrix)
    assert other[AD].error == pytest.approx(other[FD_GNS].error, rel=1e-6)
    assert other[ADJOINT].error == pytest.approx(0.0, abs=1e-9)
    assert other[ADJOINT_MEAN].error == pytest.approx(0.5 * (other[AD].error or 0.0), rel=1e-6)
    assert (other[AD].error or 0.0) > 0.01
    some = gradients.sampled(100)
    assert len(some) == 10
    assert min(len(set((some % 10).tolist())), len(set((some // 10).tolist()))) >= 8


def test_costs_are_multiplied_from_what_was_run() -> None:
    tasks: list[Task] = []

    def run(task: Task) -> Usage:
        tasks.append(task)
        rest = 0.05 * task.runs if task.work is Work.MPM else 4.0
        particles = particle_count(columns.column(task.scale, task.scene))
        return Usage(dimension=2, particles=particles, nodes=800, forward=2.0, rest=rest, extra=1_000)

    def costs(size: Size) -> dict[tuple[str, int], Cost]:
        found = columns.over_particles(ORIGIN, sizes=(size,), run=run).costs
        return {(each.method, each.unknowns): each for each in found}

    whole = costs(Size(scale=1.0))
    assert whole[AD, 1].seconds == whole[AD, 10].seconds == pytest.approx(6.0)
    assert whole[FD_GNS, 10].seconds == pytest.approx(21 * 2.0)
    assert whole[FD_MPM, 10].seconds == pytest.approx(2.0 + 1.0)
    assert whole[AD_LONG, 1].seconds == pytest.approx(6.0)
    assert (AD_LONG, 10) not in whole
    assert [whole[key].measured for key in ((AD, 1), (FD_GNS, 1), (FD_MPM, 10))] == ["", "one rollout", ""]
    part = costs(Size(scale=5.0, most_runs=2, long=False))
    assert (AD_LONG, 1) not in part
    assert part[FD_MPM, 10].seconds == pytest.approx(2.0 + 1.0)
    assert (part[FD_MPM, 10].memory, part[FD_MPM, 10].measured) == (10_000, "2 of 20 runs side by side")
    # Two runs side by side are run once for both.
    assert [task.runs for task in tasks if task.work is Work.MPM] == [2, 20, 2]
    found = [particle_count(columns.column(size.scale, size.scene)) for size in columns.SIZES]
    assert found == [3_200, 12_800, 80_000, 11_115]
    assert whole[ADJOINT, 1].seconds == whole[ADJOINT, 10].seconds == pytest.approx(6.0)


def test_cases_that_are_kept_are_not_measured_again() -> None:
    tasks: list[Task] = []

    def run(task: Task) -> Usage:
        tasks.append(task)
        return Usage(dimension=2, particles=3_200, nodes=800, forward=2.0, rest=1.0, extra=1_000)

    saved: list[OverParticles] = []
    whole = columns.over_particles(ORIGIN, sizes=columns.SIZES[:1], run=run, keep=saved.append)
    assert [each.work for each in tasks] == [Work.AD, Work.LONG, Work.GNS, Work.ADJOINT, Work.MPM, Work.MPM]
    tasks.clear()
    again = columns.over_particles(ORIGIN, sizes=columns.SIZES[:1], run=run, kept=saved[2].costs)
    assert [each.work for each in tasks] == [Work.ADJOINT, Work.MPM, Work.MPM]
    assert again == whole


def test_work_in_a_process_returns_raises_or_is_killed() -> None:
    assert isolated(os.getpid) != os.getpid()
    with pytest.raises(ZeroDivisionError):
        isolated(divmod, 1, 0)
    with pytest.raises(WorkFailed, match="out of memory"):
        isolated(signal.raise_signal, signal.SIGKILL)


def row(method: str, *curve: tuple[float, float], ended: str = "by itself") -> MethodResult:
    return MethodResult(
        method=method,
        optimiser="adam",
        forward=1.0,
        backward=2.0,
        paper=None,
        iterations=4,
        allowed=30,
        ended=ended,
        mpm_runs=0,
        seconds=curve[-1][0],
        error={"m/s": 0.1},
        curve=tuple(CheckedLoss(seconds=seconds, loss=loss) for seconds, loss in curve),
    )


def result(*rows: MethodResult, problem: str = "friction-tall-42", origin: Origin = ORIGIN) -> ProblemResult:
    return ProblemResult(
        origin=origin, problem=problem, start="30", rule="a loss", limit=40.0, floor=1e-6, methods=rows
    )


def over_unknowns(ad: float = 10.0, mpm: float = 1.0) -> OverUnknowns:
    """AD at a constant cost, differences at one for each unknown."""
    per_unknown = {AD: 0.0, FD_GNS: 20.0, ADJOINT: 0.0, ADJOINT_MEAN: 0.0, FD_MPM: mpm, FD_JITTER: mpm}
    cosines = {AD: 0.91, FD_GNS: 0.9, ADJOINT: 0.95, ADJOINT_MEAN: 0.97, FD_MPM: 0.999, FD_JITTER: 0.99}
    found = tuple(
        Gradient(
            method=method,
            unknowns=number,
            seconds={AD: ad, ADJOINT: 4.0, ADJOINT_MEAN: 16.0}.get(method, cost * number),
            columns=min(number, 10) if cost else number,
            cosine=cosines[method],
            error=0.2,
        )
        for number in (1, 10, 100)
        for method, cost in per_unknown.items()
    )
    return OverUnknowns(origin=ORIGIN, particles=3_920, steps={"1": 0.15, "100": 0.5}, gradients=found)


def over_particles(ad: float = 1.0) -> OverParticles:
    """AD's seconds grow with the particles, the MPM's with their 1.5th power."""
    return OverParticles(
        origin=ORIGIN,
        costs=tuple(
            Cost(
                method=method,
                particles=1_000 * n,
                nodes=1_000 * n,
                unknowns=unknowns,
                seconds=seconds,
                memory=10**9,
                measured="10 steps" if n == 100 else "",
            )
            for n in (1, 10, 100)
            for unknowns in (1, 10)
            for method, seconds in (
                (AD, ad * n),
                *([(AD_LONG, 8.0 * ad * n)] if unknowns == 1 else []),
                (ADJOINT, 0.4 * n**1.5),
                (FD_GNS, 10.0 * unknowns * n),
                (FD_MPM, 0.1 * unknowns * n**1.5),
            )
        ),
    )


def test_a_crossing_is_found_where_it_is() -> None:
    flat, rising = [(1.0, 20.0), (10.0, 20.0), (100.0, 20.0)], [(1.0, 2.0), (10.0, 8.0), (100.0, 50.0)]
    # On logarithmic axes between 10 and 100: 8 (n / 10)^a = 20 with 8 10^a = 50.
    assert crossing(flat, rising) == pytest.approx(10.0 * (20.0 / 8.0) ** (1.0 / math.log10(50.0 / 8.0)), rel=1e-9)
    assert math.isinf(crossing(rising, flat))
    assert crossing([(1.0, 1.0), (100.0, 1.0)], rising) == 1.0
    assert math.isinf(crossing([(1.0, 3.0), (10.0, 1.0), (100.0, 60.0)], rising))


def test_sentences_follow_the_numbers() -> None:
    text = unknowns_cost(over_unknowns())
    assert f"{AD} is cheaper than {FD_MPM} from about 10 unknowns on" in text
    assert f"{ADJOINT} is cheaper than {FD_MPM} from about 4 unknowns on" in text
    assert f"at 100, of the seconds of {FD_MPM}, {AD} 10 % and {ADJOINT} 4 %" in text
    assert f"{AD} is not cheaper than {FD_MPM} up to 100 unknowns" in unknowns_cost(over_unknowns(ad=1_000.0))
    text = unknowns_cosine(over_unknowns())
    assert f"at 10 / 100 unknowns: {AD} 0.910 / 0.910; {ADJOINT} 0.950 / 0.950; {ADJOINT_MEAN} 0.970 / 0.970;" in text
    # 0.5 n = 0.1 n^1.5 at n = 25 thousand, 0.5 n = 0.4 n^1.5 at 1.6.
    text = particles_cost(over_particles(ad=0.5))
    assert (
        f"with 1 unknown {ADJOINT} is not cheaper than {FD_MPM} up to 100,000 particles; {AD} is cheaper than" in text
    )
    assert "from about 25,000 particles on" in text
    assert f"{AD} is cheaper than {ADJOINT} from about 1,600 particles on" in text
    assert f"with 10 unknowns {ADJOINT} is cheaper than {FD_MPM} from 1,000 to 100,000 particles" in text
    memory, long = particles_memory(over_particles(ad=1.5))
    costs = ", ".join(f"{method} 1 GB" for method in (AD, ADJOINT, FD_GNS, FD_MPM))
    assert memory == f"Memory at 100,000 particles and one unknown: {costs}."
    assert "400 steps, of 100,000 nodes take 1 GB and 20.0 minutes; the paper's code exceeds 16 GB at about" in long
    slow, fast = row("AD, GNS", (3.0, 1e-2), (30.0, 1e-3)), row("differences, MPM", (1.0, 2e-2), (9.0, 1e-5))
    ours = row("adjoint, MPM", (2.0, 1e-2), (12.0, 1.4e-5))
    text = best_of(result(slow, ours, fast))
    assert "Least MPM loss 1.0e-05 (at the truth 1.0e-06) by differences, MPM" in text
    assert "first below 1.5e-05: differences, MPM, after 9 s; AD, GNS ends at 1.0e-03, 100 times the least" in text
    assert "adjoint, MPM ends at 1.4e-05, 1.4 times the least, there after 12 s" in text
    # Below the scatter all losses are alike, and the first one there counts.
    near = row("AD, GNS", (2.0, 1.2e-6))
    text = best_of(result(near, row("adjoint, MPM", (6.0, 3e-7)), row("differences, MPM", (5.0, 2e-7))))
    assert "by differences, MPM; first below 1.5e-06: AD, GNS, after 2 s" in text


def test_what_the_surrogate_is_for_follows_the_numbers() -> None:
    far, ours = row("AD, GNS", (1.0, 9e-5), (3.0, 5e-5)), row("adjoint, MPM", (2.0, 1e-2), (12.0, 1e-5))
    fine = row("differences of 0.1 m, MPM", (2.0, 1e-2), (9.0, 1.1e-5))
    one, other = result(far, ours, fine), result(row("AD, GNS", (1.0, 9e-3)), ours, problem="baffles-2")
    said = surrogate_use(Parts(problems={"a": one, "b": other}, unknowns=over_unknowns(ad=1.0)))
    assert f"its gradient takes 0.25 of the seconds of {ADJOINT} over the unknowns" in said
    assert "by it alone 0 of 2 problems end at the MPM's level, and on 1 it is first within ten times" in said
    assert problems_best([one, other]) == (
        "First within 1.5 times the least MPM loss: differences, MPM (friction-tall-42 9 s);"
        " adjoint, MPM (baffles-2 12 s)."
    )
    assert len(conclusion(Parts(problems={"a": one}, unknowns=over_unknowns(), particles=over_particles()))) == 5


def test_the_page_marks_what_was_multiplied() -> None:
    rows = (
        row("AD, GNS", (12.0, 1e-3), ended="out of time"),
        row("adjoint, MPM", (12.0, 1e-3)),
        dataclasses.replace(row("secants, MPM", (12.0, 1e-3)), sample=16),
    )
    parts = Parts(problems={"a": result(*rows)}, unknowns=over_unknowns(), particles=over_particles())
    text = str(efficiency_page.page(parts))
    assert "≈ 90 s for 30" in text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert any(line[:4] == ["100", FD_MPM, "≈ 100.00", "10 of 100"] for line in cells)
    assert any(line[:4] == ["10", FD_MPM, "10.00", "all"] for line in cells)
    assert any(line[5] == "16 + 4" for line in cells if line[0] == "secants, MPM")
    assert any(line[0] == "100,000" and line[-1] == "10 steps" and line[4].startswith("≈") for line in cells)
    assert "2000-01-01, on a machine" in text
    quick = dataclasses.replace(ORIGIN, quick=True)
    assert "--quick" in str(efficiency_page.page(Parts(problems={"a": result(*rows, origin=quick)})))


def test_a_run_that_was_cut_short_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def measure(name: str, origin: Origin, *_: object) -> ProblemResult | OverUnknowns | OverParticles:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(name)
        if name == "unknowns":
            return dataclasses.replace(over_unknowns(), origin=origin)
        if name == "particles":
            return dataclasses.replace(over_particles(), origin=origin)
        rows = row("AD, GNS", (1.0, 0.1), (2.0, 0.01)), row("adjoint, MPM", (1.0, 0.1))
        return result(*rows, problem=name, origin=origin)

    monkeypatch.setattr(bench, "measure", measure)
    drawn: list[str] = []
    for name in ("draw_problem", "draw_unknowns", "draw_particles"):
        monkeypatch.setattr(efficiency_page, name, lambda path, _: drawn.append(path.name))
    keep, names = tmp_path / "keep", [*bench.LIMITS, "unknowns", "particles"]
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            bench.bench(tmp_path, quick=False, keep=keep)
        names, first = names[3:], list(done)
        done.clear()
    assert first == ["baffles-2", "cohesion-friction", "unknowns"]
    said = bench.bench(tmp_path, quick=False, keep=keep)
    assert done == ["particles"]
    text = (tmp_path / "efficiency.md").read_text()
    assert said in text
    assert all(name in text for name in bench.LIMITS)
    assert records.read(tmp_path) == records.read(keep)
    assert drawn == [f"efficiency-{name}.png" for name in (*bench.LIMITS, "unknowns", "particles")]
    # What was measured with `--quick` is no part of the whole.
    done.clear()
    bench.bench(tmp_path, quick=True, keep=keep)
    assert done == ["friction-tall-42", "unknowns", "particles"]


def test_pictures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots, "DPI", 30)
    efficiency_page.draw_problem(tmp_path / "a.png", result(row("AD, GNS", (1.0, 0.1), (2.0, 0.01))))
    efficiency_page.draw_unknowns(tmp_path / "b.png", over_unknowns())
    efficiency_page.draw_particles(tmp_path / "c.png", over_particles())
    assert all((tmp_path / name).stat().st_size > 1_000 for name in ("a.png", "b.png", "c.png"))


@pytest.mark.parametrize("text", ["{", "[]", '{"race": {}}'])
def test_a_file_of_another_kind_is_an_error(tmp_path: Path, text: str) -> None:
    (tmp_path / records.FILE).write_text(text)
    with pytest.raises(InputError, match=records.FILE):
        records.read(tmp_path)


def test_the_kept_figures_in_docs_are_read() -> None:
    parts = records.read(Path(__file__).parents[3] / "docs")
    assert set(parts.problems) == set(bench.LIMITS)
    assert parts.unknowns is not None
    assert parts.particles is not None
