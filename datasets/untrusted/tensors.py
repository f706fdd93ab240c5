"""Safetensors of anybody's: a header of limited size and depth, then tensors as large as the file."""

from pathlib import Path

from datasets.errors import InputError
from datasets.untrusted.files import file_size, reading
from datasets.untrusted.text import json_object

WHAT = "whole weights of a model"
LARGEST_HEADER = 2**24
"""Bytes; a model of ours has some ten thousand."""
TORCH = b"PK\x03\x04"
"""How files of torch begin, in which models were kept up to format 3."""


def check_tensors(path: Path) -> None:
    """Raise InputError for a file that is none of safetensors, or that has a header beyond any honest one."""
    size = file_size(path, WHAT)
    with reading(path, WHAT):
        with path.open("rb") as file:
            head = file.read(8)
            if head[:4] == TORCH:
                raise InputError(
                    "expected a model as .safetensors, got a file of torch; those are of older physics and features, "
                    "train anew with python -m gns.train"
                )
            header = int.from_bytes(head, "little")
            if not 2 <= header <= min(LARGEST_HEADER, size - 8):
                raise InputError(f"expected {WHAT}, the file states a header of {header} bytes")
            text = file.read(header).decode("utf-8")
        json_object(text)
