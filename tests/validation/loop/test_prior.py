"""A stated prior in the loop: half-widths, files, reports; `posterior.nc` as HDF5 and in ArviZ."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from inverse import Prior, inference_data, save
from inverse.answer import Verdict
from tests.validation.loop.flows import Case, Formula, layers, wedge

NOISE, SLOPE = 0.06, 0.0164
"""Of the front [m], and how much of it a degree is."""


def case_of(folder: Path, prior: Prior, **changes: float) -> Case:
    case = wedge(folder, truth=27.0, scatter=0.002, **changes)
    (known,) = case.problem.parameters
    parameters = (replace(known, initial=None, prior=prior),)
    return replace(case, problem=replace(case.problem, parameters=parameters))


def test_a_prior_counts_as_much_as_a_measurement(tmp_path: Path) -> None:
    case = case_of(tmp_path, Prior(kind="normal", mean=24.0, deviation=3.0), noise=NOISE)
    found = case.solve(tmp_path / "out")
    save(found, tmp_path / "out")
    noise = NOISE / SLOPE
    assert found.certainty["friction_deg"] == pytest.approx(1.96 * 3.0 * noise / np.hypot(3.0, noise), rel=0.3)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["prior"] == {"friction_deg": {"kind": "normal", "mean": 24.0, "deviation": 3.0}}
    assert result["correlations"] == []
    with h5py.File(tmp_path / "out" / "posterior.nc") as file:
        assert set(file) == {"posterior", "prior", "posterior_predictive", "observed_data"}
        samples, drawn = file["posterior/friction_deg"], file["prior/friction_deg"]
        assert samples.attrs["units"] == drawn.attrs["units"] == "deg"
        assert (samples.shape, drawn.shape) == ((2, 1500), (1, 3000))
        assert [axis[0].name for axis in samples.dims] == ["/posterior/chain", "/posterior/draw"]
        weighed = found.posterior.samples.weights @ found.samples[:, 0]
        assert samples[...].mean() == pytest.approx(weighed, abs=0.02)
        assert drawn[...].std() == pytest.approx(3.0, rel=0.1)
        front, shown = file["observed_data/front"][...], file["posterior_predictive/front"]
        np.testing.assert_allclose(front, case.target.values)
        assert shown.shape == (2, 1500, 1)
        # What is not known of the angle, and the noise of another measurement.
        assert shown[...].std() == pytest.approx(np.hypot(NOISE, SLOPE * samples[...].std()), rel=0.3)


@pytest.mark.parametrize("mean", [24.0, 40.0])
def test_a_surrogate_leads_with_a_prior_that_may_contradict_the_deposit(tmp_path: Path, mean: float) -> None:
    case = case_of(tmp_path, Prior(kind="normal", mean=mean, deviation=2.0))
    found = case.led(Formula(case.target.observation, 1.02)).solve(tmp_path)
    assert found.verdict is Verdict.CONFIRMED
    assert abs(found.unknowns["friction_deg"] - 27.0) < 2.0 * found.certainty["friction_deg"] < 2.5


READING = """
import matplotlib
matplotlib.use("Agg")
import arviz
found = arviz.from_netcdf("posterior.nc")
arviz.plot_pair(found)
assert float(arviz.summary(found, round_to="none").r_hat.max()) < 1.1
assert found.posterior["masses[0].velocity_x"].attrs["units"] == "m/s"
"""


@pytest.mark.slow
def test_arviz_plots_it_as_it_is(tmp_path: Path) -> None:
    inference_data.write(layers(tmp_path, scatter=0.002).solve(tmp_path), tmp_path / "posterior.nc")
    with h5py.File(tmp_path / "posterior.nc") as file:
        # A deposit has too many numbers.
        assert set(file) == {"posterior", "prior"}
    if importlib.util.find_spec("arviz") is None:
        pytest.skip("arviz is in the extra dev")
    subprocess.run([sys.executable, "-W", "ignore", "-c", READING], cwd=tmp_path, check=True)
