"""`python -m gns.average MODEL... --out PATH`: the model whose weights are the mean over models.

Models of one line of training, each begun with the one before, lie in one valley of the loss, and their errors differ:
the mean of their weights often errs less than each of them (Izmailov, Podoprikhin, Garipov, Vetrov & Wilson, Averaging
weights leads to wider optima and better generalization, UAI 2018). It costs no training and a rollout no time. Models
that were begun with other random weights have nothing to average: score the result before it is used.
"""

import sys
from pathlib import Path

import torch

from datasets import command_line
from datasets.errors import InputError
from gns.inference import member_path
from gns.model import checkpoint


def average(*models: Path, out: Path, members: bool = False) -> None:
    """Average the weights of two models or more, of the same settings and normalisation; leaves OUT.

    The models that were averaged make an ensemble, whose spread says how far the mean may err (`gns.uncertainty`).

    Parameters
    ----------
    models
        The models' files, in the order of their training: OUT has the history of the last.
    out
        File of the new model, NAME.safetensors.
    members
        Copy the models beside it, as NAME-1.safetensors and so on.
    """
    if out.suffix != checkpoint.ENDING:
        raise InputError(f"expected a name that ends in {checkpoint.ENDING}", where=str(out), key="--out")
    if len(models) < 2:
        raise InputError(f"expected at least two models, got {len(models)}", where="MODELS")
    loaded = [checkpoint.load(path) for path in models]
    last = loaded[-1]
    states = [model.simulator.state_dict() for model in loaded]
    trained = {name for name, _ in last.simulator.named_parameters()}
    for path, model, state in zip(models, loaded, states, strict=True):
        if model.simulator.settings != last.simulator.settings:
            raise InputError(f"expected a model of the settings of {models[-1]}", where=str(path), key="settings")
        if any(not torch.equal(value, state[name]) for name, value in states[-1].items() if name not in trained):
            raise InputError(f"expected the normalisation of {models[-1]}", where=str(path), key="state")
    for number, model in enumerate(loaded if members else (), start=1):
        checkpoint.save(member_path(out, number), model.simulator, model.provenance)
    mean = {name: torch.stack([state[name] for state in states]).mean(dim=0) for name in trained}
    last.simulator.load_state_dict(states[-1] | mean)
    own = {
        "command": f"python -m gns.average {' '.join(map(str, models))} --out {out}",
        "averaged": [model.provenance.get("command") for model in loaded],
    }
    checkpoint.save(out, last.simulator, {**last.provenance, **own})


if __name__ == "__main__":
    sys.exit(command_line.run(average, "python -m gns.average"))
