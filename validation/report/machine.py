"""What a figure was measured on."""

import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
MPM = {"Taichi": "taichi", "NumPy": "numpy"}
GNS = {"PyTorch": "torch", "Numba": "numba"}
"""What a part of Talus computes with, by name, and its package."""


def machine(packages: Mapping[str, str] = MPM) -> str:
    """Processor, cores and versions in a line."""
    features = "" if not wide_vectors() else " with AVX-512"
    versions = ", ".join(f"{name} {version(package)}" for name, package in packages.items())
    return f"{processor()}{features}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}"


def processor() -> str:
    """The processor's own name where the system tells it."""
    return cpuinfo("model name") or platform.processor() or platform.machine()


def wide_vectors() -> bool:
    """Whether the processor has vector registers of 64 bytes."""
    return "avx512f" in cpuinfo("flags").split()


def cpuinfo(key: str) -> str:
    """The first value of `key` in Linux's description of its processors, empty elsewhere."""
    if not CPUINFO.exists():
        return ""
    lines = (line.partition(":") for line in CPUINFO.read_text(encoding="utf-8").splitlines())
    return next((value.strip() for name, _, value in lines if name.strip() == key), "")
