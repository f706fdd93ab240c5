"""The page on the paper's columns says what its numbers say."""

import numpy as np
import pytest

from datasets.library import read_scene
from validation.bench.columns.paper_columns import (
    CELL,
    DAMPINGS,
    FINE,
    SHORT,
    STEP,
    Outcome,
    Variant,
    closest,
    text,
    variants,
)

STATED = {"short-21": 0.7, "tall-42": 0.5}


def outcomes(factors: dict[float, float]) -> dict[Variant, Outcome]:
    """Runouts of a factor of the stated ones, by damping; APIC runs 10 % shorter."""
    found = {}
    for each in variants(CELL, FINE):
        factor = factors[each.damping] * (0.9 if each.apic else 1.0)
        runouts = {name: np.array([factor * d, factor * d]) for name, d in STATED.items()}
        found[each] = Outcome(runouts=runouts, fronts=runouts)
    return found


def test_every_damping_is_tried_by_both_transfers() -> None:
    tried = variants(CELL, FINE)
    assert len(tried) == len(set(tried))
    for damping in DAMPINGS:
        mine = [each for each in tried if each.damping == damping]
        assert {each.apic for each in mine} == {False, True}
        assert {(each.cell, each.step) for each in mine if not each.apic} == {(CELL, STEP), (CELL, SHORT), (FINE, STEP)}


def test_a_variant_is_the_scene_that_it_names() -> None:
    scene = Variant(damping=0.05, cell=FINE, step=SHORT, apic=True).scene(read_scene("column-tall-42"), 3)
    assert (scene.damping, scene.domain.cell, scene.step_fraction, scene.seed) == (0.05, FINE, SHORT, 3)
    assert scene.relaxation == 0.0
    assert Variant(damping=0.05).scene(read_scene("column-tall-42"), 0).relaxation > 0.0


def test_the_conclusion_follows_the_numbers() -> None:
    found = outcomes({0.12: 0.96, 0.05: 1.1, 0.0: 1.2})
    assert closest(found, STATED) == Variant(damping=0.12)
    lines = text(found, STATED, 2)
    assert "- Damping 0.12: 4 % rms from the paper's runouts, on average 4 % too short" in lines
    assert "- Damping 0.05: 10 % rms from the paper's runouts, on average 10 % too far" in lines
    assert "by APIC 14 %" in lines
    assert "- The closest is 0.12, with 4 % rms: within 5 % it is." in lines
    worse = text(outcomes({0.12: 0.9, 0.05: 0.93, 0.0: 1.2}), STATED, 2)
    assert "- The closest is 0.05, with 7 % rms: within 5 % **it is not**." in worse


def test_deviations_do_not_cancel() -> None:
    outcome = Outcome(runouts={"short-21": np.array([0.77]), "tall-42": np.array([0.45])}, fronts={})
    assert outcome.rms(STATED) == pytest.approx(0.1)
    assert outcome.mean(STATED) == pytest.approx(0.0, abs=1e-12)
