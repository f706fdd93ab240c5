"""A surrogate of one's own, for floors far smoother than the shipped one knows well: its rollouts are corrected."""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from datasets.definitions import read_definition
from gns.checkpoint import load
from gns.library import model_path
from gns.samples import flows_of
from gns.score import evaluate, table
from gns.training import fit
from inverse.adaptation import training_settings
from mpm.generate import generate

piles = read_definition(str(Path(__file__).with_name("piles.toml")))
training = dataclasses.replace(training_settings(minutes=0.4), clock="cpu")
with tempfile.TemporaryDirectory() as folder:
    data, run = Path(folder, "piles"), Path(folder, "run")
    generate(piles, data, seed=0, count=32, jobs=2)
    shipped = load(model_path("flow2d"))
    settings = shipped.simulator.settings
    fit([data], run, model=settings, training=training, begin=shipped)
    unseen = flows_of(data, "test", settings)
    before = evaluate(shipped.simulator, unseen)
    after = evaluate(load(model_path(run)).simulator, unseen)
print(f"before\n\n{table(before)}\nafter\n\n{table(after)}")
errors = [np.mean([abs(each.front_error) + each.profile_error for each in scores]) for scores in (before, after)]
print(f"front and profile are off by {100 * errors[0]:.1f} % of the extent before, {100 * errors[1]:.1f} % after")
assert errors[1] < 0.6 * errors[0]
assert errors[1] < 0.15
