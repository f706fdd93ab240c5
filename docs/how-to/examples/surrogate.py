"""A surrogate of one's own: the shipped one, which knows smooth floors badly, learns a small dataset of them."""

import tempfile
from pathlib import Path

import numpy as np

from datasets.definitions import read_definition
from gns.checkpoint import load
from gns.library import model_path
from gns.score import evaluate, table
from gns.settings import TrainingSettings
from gns.training.loop import fit
from gns.training.samples import flows_of
from mpm.generate import generate

piles = read_definition(str(Path(__file__).with_name("piles.toml")))
# Half a minute; serious trainings have minutes in place of updates, and leave the rest as it is.
short = TrainingSettings(
    updates=120, unroll=(4, 8), learning_rate=1.0e-3, warmup=10, average=0.95, first=0.3, loss_scale=0.5, validations=1
)
with tempfile.TemporaryDirectory() as folder:
    data, run = Path(folder, "piles"), Path(folder, "run")
    generate(piles, data, seed=0, count=24, jobs=2)
    shipped = load(model_path("flow2d"))
    settings = shipped.simulator.settings
    unseen = flows_of(data, "test", settings)
    before = evaluate(shipped.simulator, unseen)
    fit([data], run, model=settings, training=short, begin=shipped)
    after = evaluate(load(model_path(run)).simulator, unseen)
print(f"before\n\n{table(before)}\nafter\n\n{table(after)}")
first, last = (np.mean([abs(each.front) + each.profile for each in scores]) for scores in (before, after))
print(f"front and profile are off by {100 * first:.1f} % of the deposit's extent before, {100 * last:.1f} % after")
assert last < 0.7 * first
assert last < 0.1
