"""How many hostile files, and what came of them, by kind, at the end."""

from collections.abc import Iterator

import pytest

from tests.fuzz.asking import Worker

REPORT = pytest.StashKey[dict[str, str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--fuzz N`: scenes, problems and definitions together; a fifth of it of each other family."""
    parser.addoption("--fuzz", type=int, default=10_000, help="files of a run of the fuzzer")


@pytest.fixture(scope="session")
def worker(request: pytest.FixtureRequest) -> Iterator[Worker]:
    """The process that reads them."""
    worker = Worker()
    yield worker
    worker.close()
    request.config.stash[REPORT] = {kind: str(tally) for kind, tally in worker.tallies.items()}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """A line for each kind."""
    for kind, line in config.stash.get(REPORT, {}).items():
        terminalreporter.write_line(f"{kind:10s} {line}")
