"""The columns of the page on the transfer, the figures of a run, and conclusions that follow the numbers."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from datasets.trajectory import Trajectory
from mpm.resolution import particle_steps
from validation.bench.columns.transfer import (
    APIC,
    DEFAULT,
    INFINITE,
    QUICK,
    Column,
    Figures,
    Plan,
    criterion,
    figures,
    spread,
    write,
)

PLAN = dataclasses.replace(QUICK, cells=(10, 20, 40, 80), seeds=(2, 1, 1, 1), relaxations=(APIC, 0.5, 1.0, INFINITE))


def made_up(plan: Plan, *, slope: float, apic: float = 0.0) -> dict[Column, Figures]:
    """Fronts that grow by `slope` with each tenfold stiffness, by `apic` too with APIC."""
    return {
        column: Figures(
            front=1.0 + (slope + (apic if column.relaxation == APIC else 0.0)) * math.log10(column.stiffness),
            kinetic=1e-4,
            rise=0.0,
        )
        for column in plan.columns()
    }


def test_a_column_is_the_scene_that_it_names() -> None:
    scene = Column(cells=20, stiffness=10.0, step=0.3, interval=0.01, relaxation=2.0, corrected=True, seed=3).scene()
    assert (scene.domain.cell, scene.material.young, scene.step_fraction, scene.frame_dt) == (0.01, 2e7, 0.3, 0.01)
    assert scene.relaxation == pytest.approx(math.sqrt(0.01 / 9.81))
    assert (scene.volume_correction, scene.seed) == (True, 3)
    assert Column().scene().relaxation_time is None
    assert Column(relaxation=APIC).scene().relaxation == 0.0
    soft, stiff = (Column(dimension=3, cells=6, stiffness=each).scene() for each in (1.0, 100.0))
    assert stiff.material.young == pytest.approx(100.0 * soft.material.young)
    assert soft.domain.cell == pytest.approx(0.1 / 6)


def test_the_plan_stays_within_its_budget() -> None:
    plan = Plan()
    columns = plan.columns()
    assert len(columns) == len(set(columns))
    seconds = sum(particle_steps(column.scene()) / {2: 30e6, 3: 16e6}[column.dimension] for column in columns)
    assert seconds < 480.0
    tried = set(plan.grid(plan.coarse, 1.0))
    assert {(column.stiffness, column.step) for column in tried} == {
        (stiffness, step) for stiffness in plan.stiffnesses for step in plan.steps
    }
    assert {column.interval for column in tried} == set(plan.intervals)


def test_a_spread_is_of_the_extremes_over_the_mean() -> None:
    found = {Column(seed=seed): Figures(front=x, kinetic=0.0, rise=0.0) for seed, x in enumerate((0.9, 1.0, 1.1))}
    assert spread(found, found) == pytest.approx(0.2)


def test_the_conclusion_follows_the_numbers(tmp_path: Path) -> None:
    good = write(tmp_path, PLAN, made_up(PLAN, slope=0.01, apic=0.1))
    assert "over stiffness, step and output the fronts spread by 1 % on 5 cells" in good
    assert "across (criterion 3 %, met; APIC's 10 %)" in good
    assert "**missed**" not in good
    assert (tmp_path / "transfer.png").stat().st_size > 10_000
    bad = write(tmp_path, PLAN, made_up(PLAN, slope=0.05))
    assert "4.9 % on 5 cells across (criterion 3 %, **missed**" in bad


def test_a_front_is_compared_with_the_finest_grids(tmp_path: Path) -> None:
    found = made_up(PLAN, slope=0.0)
    for column in found:
        if column.cells == 20 and column.relaxation == DEFAULT:
            found[column] = dataclasses.replace(found[column], front=1.05)
    lines = write(tmp_path, PLAN, found)
    assert "+5.0 % on 20 cells (criterion 4 %, **missed**; APIC's +0.0 %)" in lines
    assert "+0.0 % on 40 cells (criterion 1.5 %, met" in lines


def test_energies_are_read_from_the_summary() -> None:
    scene = Column().scene()
    energy = {"kinetic": [0.0, 4.0, 1.0], "potential": [10.0, 4.0, 5.0], "elastic": [0.0, 0.0, 3.0]}
    flow = Trajectory(
        positions=np.zeros((1, 4, 2), np.float32),
        time=np.array([1.5]),
        velocity0=np.zeros((4, 2), np.float32),
        friction=np.zeros(4, np.float32),
        scene=scene,
        summary={"energy": energy},
    )
    found = figures(flow)
    assert found.kinetic == pytest.approx(0.25)
    assert found.rise == pytest.approx(1.0)
    assert criterion(0.02, 0.02) == "criterion 2 %, met"
