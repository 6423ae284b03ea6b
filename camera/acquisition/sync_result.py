"""Result of synchronisation of one display and one camera with one exposure: latency, settling, shutter."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from optolever.errors import InputError
from optolever.projector import Accepted
from optolever.schema import from_table

__all__ = ["SAFE_WAIT_S", "Timing"]

#: Without a measurement: the wait of public rigs for slow displays, 30 refreshes at 60 Hz.
SAFE_WAIT_S = 0.5


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds, by the stamps of the camera (whatever of an exposure they mark).

    latency_s: from a swap to the light, less the constant part of the stamps; jitter_s: largest lateness of
    one swap's light; rise_s, fall_s: time constants of the cells; shutter_s: from the first row to the last
    (negative: upwards); read_out_s: from the end of the last row's exposure to the arrival; period_s: of
    the images; refresh_s: None where unknown; misfit: rms of the light that the model does not explain, of
    the swing; flicker: rms of white images over their mean; sigma_s: of latency, rise, fall, shutter.
    camera, display: their addresses. A Timing holds for its exposure, bits and trigger.
    """

    latency_s: float
    jitter_s: float
    rise_s: float
    fall_s: float
    shutter_s: float
    read_out_s: float
    period_s: float
    exposure_s: float
    refresh_s: float | None = None
    misfit: float = 0.0
    flicker: float = 0.0
    bits: int = 8
    trigger: str = "free"
    camera: str = ""
    display: str = ""
    sigma_s: Mapping[str, float] | None = None

    def ready_s(self, levels: int = 256) -> float:
        """From a swap to the first stamp whose image holds the new pattern alone, to half a level."""
        sigma = self.sigma_s or {}
        slowest = max(self.rise_s + sigma.get("rise", 0.0), self.fall_s + sigma.get("fall", 0.0))
        settled = math.log(2 * levels) * slowest
        spread = 3 * sigma.get("latency", 0.0)
        return self.latency_s + self.jitter_s + settled + spread - min(self.shutter_s, 0.0)

    def lag(self, waited_s: float) -> float:
        """Share of the frame before in the mean light of the middle row of an image whose stamp is `waited_s`
        after its swap; 0 for less than `ready_s`: such an image was not taken by this timing."""
        if waited_s < self.ready_s():
            return 0.0
        begin, exposure = waited_s - self.latency_s + 0.5 * self.shutter_s, self.exposure_s
        shares = [
            tau / exposure * -math.expm1(-exposure / tau) * math.exp(-max(begin, 0.0) / tau)
            for tau in (self.rise_s, self.fall_s)
            if tau > 0
        ]
        return sum(shares) / max(len(shares), 1)

    def whole_refreshes(self, exposure_s: float) -> float | None:
        """The shortest integer number of refreshes that covers the exposure, s; None for unknown ones."""
        if self.refresh_s is None:
            return None
        return max(1, math.ceil(exposure_s / self.refresh_s - 1e-3)) * self.refresh_s

    def require(self, accepted: Accepted) -> None:
        """InputError unless it was measured with these settings: stamps mean other times with others."""
        for name, mine, theirs in (
            ("exposure_s", self.exposure_s, accepted.exposure_s),
            ("bits", self.bits, accepted.bits),
            ("trigger", self.trigger, accepted.trigger),
        ):
            texts = isinstance(mine, str) or isinstance(theirs, str)
            if mine != theirs if texts else not math.isclose(float(mine), float(theirs), rel_tol=1e-3):
                raise InputError(
                    f"sync: measured with {name} {mine!r}, the camera has {theirs!r}; optolever camera sync"
                )

    def to_table(self) -> dict[str, Any]:
        """Plain TOML types, for [sync] of a rig; unknown fields are omitted."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def from_table(cls, table: Mapping[str, Any], where: str) -> "Timing":
        """Inverse of to_table. InputError names `where` and the field."""
        return from_table(cls, table, f"{where} (by optolever camera sync)")
