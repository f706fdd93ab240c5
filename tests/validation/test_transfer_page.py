"""The cases of the transfer's page, what is read from a run, and verdicts that follow the numbers."""

import dataclasses
import math

import numpy as np
import pytest

from datasets.trajectory import Trajectory
from mpm.resolution import particle_steps
from validation.bench.columns import transfer_page as transfer_report
from validation.bench.columns.transfer_cases import APIC, NEVER, QUICK, Case, Plan
from validation.bench.columns.transfer_page import Figures, figures, spread, text

PLAN = dataclasses.replace(QUICK, cells=(10, 20, 40, 80), seeds=(2, 1, 1, 1), relaxations=(APIC, 0.5, 1.0, NEVER))


def made_up(plan: Plan, *, slope: float, apic: float = 0.0) -> dict[Case, Figures]:
    """Fronts that grow by `slope` with each tenfold stiffness, by `apic` too with APIC."""
    return {
        case: Figures(
            front=1.0 + (slope + (apic if case.relaxation == APIC else 0.0)) * math.log10(case.stiffness),
            kinetic=1e-4,
            rise=0.0,
        )
        for case in plan.cases()
    }


def test_a_case_is_the_scene_that_it_names() -> None:
    scene = Case(cells=20, stiffness=10.0, step=0.3, interval=0.01, relaxation=2.0, corrected=True, seed=3).scene()
    assert (scene.domain.cell, scene.material.young, scene.step_fraction, scene.frame_dt) == (0.01, 2e7, 0.3, 0.01)
    assert scene.relaxation == pytest.approx(math.sqrt(0.01 / 9.81))
    assert (scene.volume_correction, scene.seed) == (True, 3)
    assert Case().scene().relaxation_time is None
    assert Case(relaxation=APIC).scene().relaxation == 0.0
    soft, stiff = (Case(dimension=3, cells=6, stiffness=each).scene() for each in (1.0, 100.0))
    assert stiff.material.young == pytest.approx(100.0 * soft.material.young)
    assert soft.domain.cell == pytest.approx(0.1 / 6)


def test_the_plan_stays_within_its_budget() -> None:
    plan = Plan()
    cases = plan.cases()
    assert len(cases) == len(set(cases))
    seconds = sum(particle_steps(case.scene()) / {2: 30e6, 3: 16e6}[case.dimension] for case in cases)
    assert seconds < 480.0
    asked = set(plan.grid(plan.coarse, 1.0))
    assert {(case.stiffness, case.step) for case in asked} == {
        (stiffness, step) for stiffness in plan.stiffnesses for step in plan.steps
    }
    assert {case.interval for case in asked} == set(plan.intervals)


def test_a_spread_is_of_the_extremes_over_the_mean() -> None:
    found = {Case(seed=seed): Figures(front=x, kinetic=0.0, rise=0.0) for seed, x in enumerate((0.9, 1.0, 1.1))}
    assert spread(found, found) == pytest.approx(0.2)


def test_verdicts_follow_the_numbers() -> None:
    good = text(PLAN, made_up(PLAN, slope=0.01, apic=0.1))
    assert "spread by 1 % over stiffness, step and output (bar 3 %, met); APIC's by 10 %" in good
    assert "**missed**" not in good
    bad = text(PLAN, made_up(PLAN, slope=0.05))
    assert "spread by 4.9 % over stiffness, step and output (bar 3 %, **missed**)" in bad


def test_a_front_is_judged_against_the_finest_grids() -> None:
    found = made_up(PLAN, slope=0.0)
    for case in found:
        if case.cells == 20 and case.relaxation == 1.0:
            found[case] = dataclasses.replace(found[case], front=1.05)
    lines = text(PLAN, found)
    assert "- On 20 cells the front is +5.0 % from that on 80 (bar 4 %, **missed**); APIC's +0.0 %." in lines
    assert "- On 40 cells the front is +0.0 % from that on 80 (bar 1.5 %, met)" in lines


def test_energies_are_read_from_the_summary() -> None:
    scene = Case().scene()
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
    assert transfer_report.verdict(0.02, 0.02) == "bar 2 %, met"
