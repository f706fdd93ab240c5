"""Workers as jobs of SLURM that come and go with the work: pip install "talus[slurm]"."""

from dask_jobqueue import SLURMCluster

from mpm.cluster import connected
from validation import solve

if __name__ == "__main__":
    # A job of 32 workers of one thread each; queue and account are the site's.
    with SLURMCluster(cores=32, processes=32, memory="64GB", walltime="04:00:00", queue="normal") as slurm:
        slurm.adapt(minimum_jobs=1, maximum_jobs=8)
        with connected(slurm.scheduler_address) as cluster:
            result = solve("velocity-layers-10", "out/loop", simulate=cluster)
    print(result.verdict, result.unknowns, result.interval)
