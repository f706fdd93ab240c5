"""`posterior.nc`: posterior, prior, posterior predictive and observed data in the form of ArviZ's InferenceData.

    import arviz
    arviz.plot_pair(arviz.from_netcdf("out/posterior.nc"))

A netCDF-4 file is an HDF5 file whose axes are dimension scales (NetCDF file format specifications, Unidata), so h5py
writes it.
"""

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from datasets.files import replacing
from inverse.answer import MAX_NUMBERS
from inverse.posterior import Matrix
from inverse.posterior.posterior import Posterior
from inverse.posterior.settings import CONSTANTS
from inverse.result import Result

CHAINS = ("chain", "draw")


def write(result: Result, path: Path) -> None:
    """Write `posterior.nc`: S samples, resampled systematically to equal weights, in the order of their populations."""
    posterior, problem, observation = result.posterior, result.problem, result.target.observation
    assert posterior is not None, "an optimiser has no samples"
    rng = np.random.default_rng(problem.optimiser.seed)
    points = posterior.samples.drawn(len(posterior.samples.points), rng)
    shares = rng.random(points.shape)
    prior = shares if problem.prior is None else problem.prior.at(shares)
    # HDF5 works in memory and Python writes the file: on a full disk, HDF5 would end the process.
    with h5py.File(path.name, "w", driver="core", backing_store=False, track_order=True) as file:
        for name, samples in (("posterior", chains(points)), ("prior", prior[None])):
            columns = zip(problem.numbers, np.moveaxis(problem.box.at(samples), -1, 0), strict=True)
            fill(file, name, {number.name: (values, number.kind.unit) for number, values in columns}, CHAINS)
        observed = observation.scale * result.target.values
        if len(observed) <= MAX_NUMBERS and len(posterior.reduction.mean) == len(observed):
            shown = chains(observation.scale * predictive(posterior, points, rng))
            for name, values, axes in (("posterior_predictive", shown, CHAINS), ("observed_data", observed, ())):
                parts = {seen.name: (values[..., seen.numbers], seen.observation.unit) for seen in observation.parts}
                fill(file, name, parts, axes)
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as part:
        part.write_bytes(image)


def chains(samples: Matrix) -> Matrix:
    """Samples [S, ...] by population, shape [chains, draws, ...]."""
    return samples.reshape(CONSTANTS.populations, -1, *samples.shape[1:])


def predictive(posterior: Posterior, points: Matrix, rng: np.random.Generator) -> Matrix:
    """Draws [S, M] of measurements of further flows at points [S, U]: the emulator's mean plus all errors."""
    residual, fixed, variance = posterior.likelihood.residual(points)
    lower = np.linalg.cholesky(fixed + variance[:, :, None] * np.eye(len(fixed)))
    freedom = posterior.likelihood.freedom
    scale = np.sqrt(freedom / rng.chisquare(freedom, len(points)))
    errors = scale[:, None] * np.einsum("sij,sj->si", lower, rng.standard_normal(residual.shape))
    # Errors across the components: noise and scatter of the weighted numbers, of variance 1 each.
    basis, across = posterior.reduction.basis, rng.standard_normal((len(points), len(posterior.reduction.mean)))
    across -= (across @ basis) @ basis.T
    numbers = posterior.reduction.numbers(posterior.likelihood.target - residual + errors)
    return numbers + across / posterior.reduction.weights


def fill(file: h5py.File, group_name: str, variables: Mapping[str, tuple[Matrix, str]], first: tuple[str, ...]) -> None:
    """Write a group: name -> values and unit. `first` names the first axes; a further axis gets its own name."""
    group = file.create_group(group_name, track_order=True)
    for name, (values, unit) in variables.items():
        dataset = group.create_dataset(name, data=values, track_order=True)
        dataset.attrs["units"] = unit if unit not in ("", "-") else "1"
        for axis, length in enumerate(values.shape):
            dimension = first[axis] if axis < len(first) else f"{name}_dim_0"
            if dimension not in group:
                group.create_dataset(dimension, data=np.arange(length), track_order=True).make_scale(dimension)
            dataset.dims[axis].attach_scale(group[dimension])
