"""A file appears whole or stays as it was."""

import json
from pathlib import Path

import pytest

from datasets.files import replacing, write_json, write_text


def test_a_failing_block_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")

    def interrupted() -> None:
        with replacing(path) as part:
            part.write_text("half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_old_file_stands_until_the_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with replacing(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
        assert part.suffix == ".txt"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_folders_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b.md", "phi = 21°")
    assert (tmp_path / "a" / "b.md").read_text(encoding="utf-8") == "phi = 21°"


def test_json_has_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_json(path, {"loss": [float("nan"), 0.5], "best": (float("inf"), 1)})
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == {"loss": [None, 0.5], "best": [None, 1]}
