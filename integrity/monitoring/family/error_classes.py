"""Code errors in classes of C/N0, elevation and path: a bound of each class, saved as a preset with its source."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.presets import FILES, load_file, load_preset
from lanebound.integrity.monitoring.family.overbounds import ErrorSides

__all__ = ["ErrorClasses", "ErrorLaw", "FittedErrors"]

Array = NDArray[np.float64]

PATHS = ("any", "direct", "shadowed")


class ErrorLaw(Config):
    """Errors of one class."""

    count: int = Field(0, ge=0, description="errors that the law was fitted to [-]")
    centre_m: float = Field(0.0, description="centre of the normal overbound, subtracted from the code [m]")
    sigma_m: float = Field(gt=0, description="standard deviation of the overbound [m]")
    bias_m: float = Field(0.0, ge=0, description="half of the distance of the two centres of a paired overbound [m]")


class ErrorClasses(Config):
    """A table of laws over C/N0 x elevation x path; classes with too few errors have the law of a wider class."""

    source: str = Field("", description="data, part of it, and the method of the fit")
    sides: ErrorSides = Field(ErrorSides.BOTH, description="sides of the errors that the laws bound")
    cn0_edges_dbhz: tuple[float, ...] = Field((0.0, 60.0), min_length=2, description="edges of C/N0 classes [dB-Hz]")
    elevation_edges_deg: tuple[float, ...] = Field((0.0, 90.0), min_length=2, description="edges of elevation [deg]")
    paths: tuple[str, ...] = Field(("any",), min_length=1, description="paths: any, or direct and shadowed")
    laws: tuple[ErrorLaw, ...] = Field(
        (ErrorLaw(sigma_m=1.0),), min_length=1, description="laws by C/N0, elevation and path, the last varies fastest"
    )

    @model_validator(mode="after")
    def _one_law_a_class(self) -> ErrorClasses:
        for name in ("cn0_edges_dbhz", "elevation_edges_deg"):
            edges = getattr(self, name)
            if any(b <= a for a, b in pairwise(edges)):
                raise ValueError(f"{name} must ascend, got {edges}: sort them")
        if any(p not in PATHS for p in self.paths):
            raise ValueError(f"paths must be among {', '.join(PATHS)}, got {self.paths}: rename them")
        expected = (len(self.cn0_edges_dbhz) - 1) * (len(self.elevation_edges_deg) - 1) * len(self.paths)
        if len(self.laws) != expected:
            raise ValueError(
                f"laws must have {expected} entries, one of each class, got {len(self.laws)}: complete them"
            )
        return self

    @property
    def symmetric(self) -> bool:
        """Whether ``N(centre, sigma^2)`` of each class bounds both sides: no paired and no one-sided law."""
        return self.sides is ErrorSides.BOTH and all(law.bias_m == 0.0 for law in self.laws)

    def at(
        self, cn0_dbhz: ArrayLike, elevation_rad: ArrayLike, shadowed: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Centre and deviation of codes; outside of the edges those of the outermost class.  (...,) each [m].

        The deviation of a paired law is ``hypot(sigma, bias)``. It describes the spread and bounds nothing.
        """
        index = self.index(cn0_dbhz, elevation_rad, shadowed)
        table = np.array([(law.centre_m, np.hypot(law.sigma_m, law.bias_m)) for law in self.laws])
        return table[index, 0], table[index, 1]

    def index(
        self, cn0_dbhz: ArrayLike, elevation_rad: ArrayLike, shadowed: ArrayLike | None = None
    ) -> NDArray[np.int64]:
        """Number of the class of each code.  (...,)."""
        cn0, elevation = np.asarray(cn0_dbhz, dtype=np.float64), np.degrees(np.asarray(elevation_rad, dtype=np.float64))
        c, e = self.cn0_edges_dbhz, self.elevation_edges_deg
        i = np.clip(np.searchsorted(c, cn0, side="right") - 1, 0, len(c) - 2)
        j = np.clip(np.searchsorted(e, elevation, side="right") - 1, 0, len(e) - 2)
        path = np.zeros(cn0.shape, np.int64)
        if shadowed is not None and "shadowed" in self.paths:
            path = np.where(shadowed, self.paths.index("shadowed"), self.paths.index("direct") if "direct" in self.paths
                            else 0)  # fmt: skip
        return np.asarray((i * (len(e) - 1) + j) * len(self.paths) + path, dtype=np.int64)


class FittedErrors(Config):
    """The preset of a fit: classes of code errors, and laws of the position error in units of its deviation."""

    classes: ErrorClasses = ErrorClasses()
    rayleigh_factor: float = Field(1.0, gt=0, description="scale of the Rayleigh law over the plane deviation [-]")
    pareto_threshold: float = Field(1.0, ge=0, description="error over deviation where the Pareto tail begins [-]")
    pareto_share: float = Field(0.6, gt=0, le=1, description="share of errors beyond it [-]")
    pareto_scale: float = Field(1.0, gt=0, description="scale of the Pareto tail [-]")
    pareto_shape: float = Field(0.0, ge=-1, le=2, description="shape of the Pareto tail [-]")

    def changes(self) -> dict[str, Any]:
        """What a monitor of the family takes of it."""
        return self.to_dict()

    @classmethod
    def named(cls, name: str) -> FittedErrors:
        """From a preset or a YAML file.

        Raises
        ------
        ConfigError
            There is none of this name, it is of another kind, or a value is refused.
        """
        data = load_file(Path(name), "errors") if name.endswith(FILES) else load_preset(name)
        if data.get("kind") != "fitted_errors":
            raise ConfigError(
                f"errors must be a preset of fit-errors, got {name!r} of kind {data.get('kind')}: fit one"
            )
        return cls.load({key: value for key, value in data.items() if key != "kind"})
