"""Many runs on a cluster: here two workers on this machine, elsewhere `dask scheduler` and `dask worker` on many."""

import numpy as np
from distributed import LocalCluster

from datasets import read_scene
from mpm import LAST, simulate
from mpm.cluster import connected

if __name__ == "__main__":  # A worker is a process that imports this file.
    column = read_scene("column-short-21")
    angles = [18.0, 24.0, 30.0, 36.0]
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        connected(cluster.scheduler_address) as workers,
    ):
        flows = workers([column.with_friction_deg(angle) for angle in angles], record=LAST)
    fronts = [flow.summary["front"] for flow in flows]
    for angle, front in zip(angles, fronts, strict=True):
        print(f"{angle:.0f} degrees: front {front:.3f} m")
    assert fronts == sorted(fronts, reverse=True)  # the steeper it stands, the less it spreads
    here = simulate(flows[0].scene, record=LAST)
    assert np.array_equal(here.positions, flows[0].positions)  # to the bit
