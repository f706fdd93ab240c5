"""Flows as a model of some settings sees them: at its time step, thinned to its particles."""

from pathlib import Path

import numpy as np

from datasets.training.samples import Flow, Flows, Sample, cut, load_flows
from gns.model.settings import ModelSettings


def flows_of(dataset: Path, split: str, settings: ModelSettings, *, progress: bool = False) -> Flows:
    """The trajectories of a split (`train`, `valid`, `test`) of a dataset, by file name. Raises InputError."""
    return load_flows(
        dataset, split, step=settings.step, dimension=settings.dimension, spacing=settings.cell, progress=progress
    )


def stretch(flow: Flow, settings: ModelSettings, *, now: int, steps: int, rng: np.random.Generator) -> Sample:
    """The stretch of a flow with `steps` targets after index `now`; rng: which particles stay."""
    return cut(
        flow,
        now=now,
        steps=steps,
        history=settings.history,
        cell=settings.cell,
        kept=settings.particles_per_cell,
        rng=rng,
    )
