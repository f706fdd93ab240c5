"""The batch scripts of the page on SLURM, with a stand-in for `srun` that runs its command here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.breaking import BLOCKS, dataset_files, orphans
from tests.commands import DOCS, ROOT

FOLDER = DOCS / "how-to" / "slurm"
pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


def test_a_dataset_by_all_cores_of_a_job(tmp_path: Path) -> None:
    """Of one node with two cores, and as here."""
    (tmp_path / "bin").mkdir()
    srun = tmp_path / "bin" / "srun"
    srun.write_text('#!/bin/bash\nwhile [[ $1 == -* ]]; do shift; done\nexec "$@"\n')
    srun.chmod(0o755)
    (tmp_path / "blocks.toml").write_text(BLOCKS)
    generate = ["-m", "mpm.generate", "blocks.toml", "--count", "4"]
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    job = {"PATH": f"{srun.parent}:{Path(sys.executable).parent}:/usr/bin:/bin", "SLURM_JOB_ID": "7"}
    with subprocess.Popen(
        ["bash", str(FOLDER / "cluster.sbatch"), "python", *generate, "--out", "there"],
        cwd=tmp_path, env=here | job | {"SLURM_CPUS_PER_TASK": "2"},
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        _, error = process.communicate(timeout=240.0)
    assert process.returncode == 0, error
    assert orphans(process.pid) == []
    assert not list(tmp_path.glob("scheduler-*.json"))
    subprocess.run([sys.executable, *generate, "--out", "here"], cwd=tmp_path, env=here, check=True)
    assert dataset_files(tmp_path / "there") == dataset_files(tmp_path / "here")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.sbatch")), ids=lambda path: path.stem)
def test_a_script_is_one(path: Path) -> None:
    subprocess.run(["bash", "-n", str(path)], check=True)
