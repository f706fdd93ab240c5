"""The batch scripts of the page on SLURM, with a stand-in for `srun` that runs its command here."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.breaking import BLOCKS, dataset_files, orphans
from tests.commands import DOCS, ROOT

FOLDER = DOCS / "how-to" / "slurm"
pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


@contextmanager
def submitted(tmp_path: Path, *command: str) -> Iterator["subprocess.Popen[str]"]:
    """A job of one node with two cores."""
    (tmp_path / "bin").mkdir()
    srun = tmp_path / "bin" / "srun"
    srun.write_text('#!/bin/bash\nwhile [[ $1 == -* ]]; do shift; done\nexec "$@"\n')
    srun.chmod(0o755)
    (tmp_path / "blocks.toml").write_text(BLOCKS)
    environment = {
        **os.environ,
        "PATH": f"{tmp_path / 'bin'}:{Path(sys.executable).parent}:/usr/bin:/bin",
        "PYTHONPATH": str(ROOT),
        "SLURM_JOB_ID": "7",
        "SLURM_CPUS_PER_TASK": "2",
    }
    with subprocess.Popen(
        ["bash", str(FOLDER / "cluster.sbatch"), *command],
        cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        yield process
    assert orphans(process.pid) == []
    assert not list(tmp_path.glob("scheduler-*.json"))


def test_a_dataset_by_all_cores_of_a_job(tmp_path: Path) -> None:
    generate = ["-m", "mpm.generate", "blocks.toml", "--count", "4"]
    with submitted(tmp_path, "python", *generate, "--out", "there") as job:
        _, error = job.communicate(timeout=240.0)
    assert job.returncode == 0, error
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *generate, "--out", "here"], cwd=tmp_path, env=environment, check=True)
    assert dataset_files(tmp_path / "there") == dataset_files(tmp_path / "here")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.sbatch")), ids=lambda path: path.stem)
def test_a_script_is_one(path: Path) -> None:
    subprocess.run(["bash", "-n", str(path)], check=True)
