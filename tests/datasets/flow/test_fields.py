"""Fields of a flow between its frames; which particles of two flows are the same."""

import dataclasses

import numpy as np

from datasets.compare import compare
from datasets.flow.fields import FlowFields, pairs
from tests.datasets.conftest import toy


def test_between_two_frames_a_flow_is_linear() -> None:
    flow = toy(2)
    half = FlowFields(flow).at_time(float(flow.time[1] + flow.time[2]) / 2.0)
    np.testing.assert_allclose(half["position"], 0.5 * (flow.positions[1] + flow.positions[2]), rtol=1e-6)
    assert half["material"].dtype == np.int32
    np.testing.assert_array_equal(FlowFields(flow).at_time(1.0e3)["position"], flow.positions[-1])


def test_a_thinned_flow_has_the_particles_of_the_whole_one() -> None:
    flow = toy(2)
    chosen = np.arange(0, flow.positions.shape[1], 3)
    ratio = np.float32(flow.volumes.sum() / flow.volumes[chosen].sum())
    own = {"velocity0": flow.velocity0[chosen], "friction": flow.friction[chosen]}
    own |= {"volume": (ratio * flow.volumes[chosen]).astype(np.float32), "mass": np.zeros(len(chosen), np.int32)}
    thin = dataclasses.replace(flow, positions=flow.positions[:, chosen], **own)
    found = pairs(FlowFields(flow), FlowFields(thin))
    np.testing.assert_array_equal(found[0], chosen)
    np.testing.assert_array_equal(found[1], np.arange(len(chosen)))
    assert compare(flow, thin).apart["positions"][-1] == 0.0
    elsewhere = dataclasses.replace(thin, positions=thin.positions + np.float32(0.05))
    assert pairs(FlowFields(flow), FlowFields(elsewhere)) is None
    assert np.isnan(compare(flow, elsewhere).apart["positions"][-1])
