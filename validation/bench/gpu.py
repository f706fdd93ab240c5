"""`python -m validation.bench gpu`: rates of the MPM and a step of the network on a GPU, beside the processor."""

from functools import partial

from datasets.errors import InputError
from datasets.processes import processors
from validation.bench.measuring import turns
from validation.bench.page import Out, Rounds, between, formatted, write_page
from validation.bench.speed import NETWORK, PER_NODE, Mode, Workload, network_rows, rate, rate_rows

CASES = (
    Workload(dimension=2, cells=100, scenes=1, frames=200),
    Workload(dimension=2, cells=100, scenes=64, frames=40),
    Workload(dimension=2, cells=1770, scenes=1, frames=4),
    Workload(dimension=3, cells=32, scenes=1, frames=100),
    Workload(dimension=3, cells=32, scenes=64, frames=20),
    Workload(dimension=3, cells=106, scenes=1, frames=20),
    Workload(dimension=3, cells=212, scenes=1, frames=4),
)


def bench(*, out: Out, rounds: Rounds = 2) -> str:
    """Measure rates over sizes and steps of the networks on a GPU, in turn with all processors of the same machine.

    Raises InputError where there is no GPU.
    """
    from torch import cuda

    if not cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", where="bench gpu")
    threads = processors()
    modes: list[Mode] = [("f32", threads), ("f32", 0), ("f64", 0)]
    rates = turns({(case, mode): partial(rate, case, mode) for mode in modes for case in CASES}, rounds, "rates")
    beside = [network_rows(rounds=rounds, device=device) for device in ("cpu", "cuda")]
    gains = {case: rates[case, ("f32", 0)].median / rates[case, ("f32", threads)].median for case in CASES}
    least, most = sorted(gains, key=gains.__getitem__)[:: len(CASES) - 1]
    best = {size: max(rates[case, ("f32", 0)].median for case in CASES if case.dimension == size) for size in (2, 3)}
    on_cpu, on_gpu = ([row[PER_NODE] for row in rows] for rows in beside)
    said = [
        f"One {cuda.get_device_name()} computes up to {best[2]:.0f} million particle-steps per second in 2D and"
        f" {best[3]:.0f} million in 3D.",
        f"Beside {threads} threads of the same machine it is {gains[least]:.1f} times as fast for {least.text} and"
        f" {gains[most]:.1f} times for {most.text}.",
        f"A step of the networks with its gradient takes {between(on_gpu, '.0f')} µs per node on the GPU, and"
        f" {between(on_cpu, '.0f')} µs on one thread.",
    ]
    networks = [row | {f"GPU, {key}": other[key] for key in list(row)[3:]} for row, other in zip(*beside, strict=True)]
    forms = NETWORK | {f"GPU, {key}": form for key, form in NETWORK.items()}
    flags, table = f" --rounds {rounds}", rate_rows(rates)
    return write_page(out, "gpu", said, flags=flags, rates=table, networks=formatted(networks, forms))
