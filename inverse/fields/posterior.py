"""The posterior of an unknown field at its nodes: most probable values, widths, samples, identified nodes."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.flow import measures
from inverse.observations import Values
from inverse.parameters.field import BAND, UnknownField

IDENTIFIED = 0.5  # a value of a field is identified if the observation removes more than this share of prior variance


@dataclass(frozen=True, kw_only=True)
class FieldPosterior:
    """A field at its K nodes, in its unit; statistics cover only the nodes of the body."""

    unknown: UnknownField
    latent: Values  # the most probable u of `inverse.parameters.field`, shape [K]
    width: Values  # posterior standard deviation of u, shape [K]
    draws: Values  # samples of the field, shape [draws, K]
    truth: Values | None  # true field if known, shape [K]

    @property
    def name(self) -> str:
        return self.unknown.settings.name

    @property
    def stem(self) -> str:
        return re.sub(r"\W+", "-", self.name)

    @cached_property
    def arrays(self) -> dict[str, Values]:
        """Name -> values at the nodes, shape [K] each. `deviation` and `prior_deviation` belong to the widths of the
        95 % bands, `removed` is the share of the prior variance that the observation removes."""
        unknown, latent, width = self.unknown, self.latent, self.width
        arrays = {
            "mean": unknown.values(latent),
            "lower": unknown.values(latent - BAND * width),
            "upper": unknown.values(latent + BAND * width),
            "deviation": unknown.deviation(latent, width),
            "prior_deviation": unknown.deviation(np.zeros_like(latent), unknown.prior.deviation),
            "removed": np.asarray(1.0 - (width / unknown.prior.deviation) ** 2),
            "inside": unknown.inside.astype(np.float64),
        }
        return arrays if self.truth is None else arrays | {"truth": self.truth}

    @property
    def saved(self) -> dict[str, Values]:
        """The arrays of `field.npz`, in which the names of field k start with `k_`."""
        grid = self.unknown.grid
        return {"positions": grid.positions, "nodes": np.array(grid.nodes), "draws": self.draws} | self.arrays

    @property
    def identified(self) -> NDArray[np.bool_]:
        """Which nodes of the body the observation identifies, shape [K]."""
        return (self.arrays["removed"] > IDENTIFIED) & self.unknown.inside

    def average(self, values: Values) -> float:
        return float(values[self.unknown.inside].mean())

    def identified_box(self) -> list[tuple[float, float]] | None:
        """Smallest and largest coordinate of the identified nodes along each axis [m]; None if there are none."""
        if not self.identified.any():
            return None
        here = self.unknown.grid.positions[self.identified]
        return [(float(low), float(high)) for low, high in zip(here.min(axis=0), here.max(axis=0), strict=True)]

    def error(self, where: NDArray[np.bool_], values: Values | float | None = None) -> float | None:
        """Root mean square error of the most probable field, or of `values`, at nodes `where` [K]; None if unknown."""
        if self.truth is None or not where.any():
            return None
        return measures.rms(((self.arrays["mean"] if values is None else values) - self.truth)[where])

    def covered(self, where: NDArray[np.bool_]) -> float | None:
        """Share of the true values at nodes `where` [K] within the bands; None if they are not known."""
        if self.truth is None or not where.any():
            return None
        inside = (self.arrays["lower"] <= self.truth) & (self.truth <= self.arrays["upper"])
        return float(np.mean(inside[where]))

    def as_json(self) -> dict[str, Any]:
        inside, identified, mean = self.unknown.inside, self.identified, self.unknown.settings.mean
        deviation = self.arrays["deviation"]
        widths = {"prior": self.average(self.arrays["prior_deviation"]), "posterior": self.average(deviation)}
        errors = {"prior": self.error(inside, mean), "posterior": self.error(inside)}
        return {
            "name": self.name,
            "unit": self.unknown.unit,
            "nodes": list(self.unknown.grid.nodes),
            "values": int(inside.sum()),
            "identified": float(identified[inside].mean()),
            "identified_between": self.identified_box(),
            "variance_removed": self.average(self.arrays["removed"]),
            "deviation": widths | {"identified": float(deviation[identified].mean()) if identified.any() else None},
            "error": errors | {"prior_identified": self.error(identified, mean), "identified": self.error(identified)},
            "truth_in_band": {"all": self.covered(inside), "identified": self.covered(identified)},
        }
