"""`python -m validation.forecast RESULT SCENE --out DIR`: predicts another flow from the result of an inversion."""

import sys
from pathlib import Path

from datasets.command_line import run


def main(
    result: Path,
    scene: str,
    /,
    *,
    out: Path,
    draws: int = 40,
    model_error: float = 0.0,
    threshold: float | None = None,
    pressure: float | None = None,
    scheduler: str | None = None,
) -> None:
    """Forecast another flow with the posterior of an inversion: front, heights, forces, probability maps.

    Writes OUT/forecast.json, OUT/report.md, OUT/forecast.png, OUT/mpm, and in 3D OUT/probability-*.tif. An interrupted
    command, started again, reuses the MPM runs that are finished.

    Args:
        result: Folder of an inversion (`validation.loop` or `inverse`), or its posterior.npz.
        scene: Path of a scene in TOML, or the name of a shipped one.
        out: Folder for the results.
        draws: Number of flows, each with its own draw from the posterior and its own jitter.
        model_error: Relative standard deviation of the model itself, such as 0.1.
        threshold: In 3D, the thickness [m] above which a cell counts as covered; default as in `datasets.maps`.
        pressure: In 3D, a pressure rho v^2 [Pa] whose probability of exceedance is mapped too.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its JSON file. Its workers then run the
            MPM.
    """
    # Imported here: torch takes seconds to load, and --help does not need it.
    from contextlib import nullcontext

    from mpm import simulate_many
    from mpm.cluster import connected
    from validation.forecast.solve import forecast_scene, summary

    with nullcontext(simulate_many) if scheduler is None else connected(scheduler) as simulate:
        options = {"draws": draws, "model_error": model_error, "threshold": threshold, "pressure": pressure}
        forecast = forecast_scene(result, scene, out, simulate=simulate, **options)  # type: ignore[arg-type]
    print("\n".join(summary(forecast)))


if __name__ == "__main__":
    sys.exit(run(main, "python -m validation.forecast"))
