"""What may be wrong with locators, hall and tracker: the named effects of the locator problem.

Every effect of a locator acts through an error of table 1, so its lever arms are those of the multi-body model.
The recipes are made once (`cache`), so that models with the same effects are traced once.
Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, section 2.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from calib import Effect, Parameter
from calib.units import arcsec, ppm, um
from instruments import influence, laser_tracker
from problems.locators.errors import AXES

SOURCE = "Li Chen, Fang Qiang, Li Jiangxiong 2010, table 1; magnitudes: bench experience"
TARGETS = "targets"
STRAIGHTNESS = tuple((across, along) for along in AXES for across in AXES if across != along)
TRACKER_READINGS = ("range_offset", "scale", "transit_tilt")
ERROR_WORDS = {"dx_x": "positioning of X", "dy_y": "positioning of Y", "dz_z": "positioning of Z",
               "ex_x": "roll of X", "ey_x": "pitch of X", "ez_x": "yaw of X",
               "ex_y": "pitch of Y", "ey_y": "roll of Y", "ez_y": "yaw of Y",
               "ex_z": "tilt of Z about x", "ey_z": "tilt of Z about y", "ez_z": "roll of Z",
               "exy": "squareness X-Y", "eyz": "squareness Y-Z", "ezx": "squareness Z-X",
               **{f"d{b}_{a}": f"straightness of {a.upper()} in {b}" for b, a in STRAIGHTNESS}}


def axis_group(locator: str) -> str:
    """Name of the observations of one locator's axes."""
    return f"axes {locator}"


@cache
def locator_effects(locator: str) -> tuple[Effect, ...]:
    """The effects of one locator: zero offset, scale, squareness, straightness, pitch with its Abbe arm, hysteresis.

    locator: its key, "A". Channels are "A.x", "A.xy", "A.y(x)". An offset along z is left out: with every locator's
    offset free the frame of the tracker absorbs it.
    """
    small, angle = (1 * um, 500 * um), (2 * arcsec, 300 * arcsec)

    def effect(name: str, channel: str, slot: str, function: Callable[..., Any], parameter: Parameter) -> Effect:
        return Effect(name, slot, function, (parameter,), channel, source=SOURCE)
    effects = (
        *(effect("zero_offset", a, f"d{a}_{a}", lambda value, p: p.o, Parameter("o", "um", small)) for a in "xy"),
        *(effect("scale", a, f"d{a}_{a}", lambda value, p, along: p.k * along,
                 Parameter("k", "ppm", (5 * ppm, 2000 * ppm)))
          for a in AXES),
        *(effect("squareness", pair, f"e{pair}", lambda value, p: p.eps, Parameter("eps", "arcsec", angle))
          for pair in ("xy", "yz", "zx")),
        *(effect("straightness", f"{b}({a})", f"d{b}_{a}", lambda value, p, fraction: p.w * fraction ** 2,
                 Parameter("w", "um", small)) for b, a in STRAIGHTNESS),
        effect("pitch_abbe", "x", "ey_x", lambda value, p, along: p.kappa * along,
               Parameter("kappa", "urad/m", (5e-6, 2e-3))),
        *(influence.hysteresis(f"d{a}_{a}", "um", small, channel=a, source=SOURCE) for a in AXES))
    return tuple(replace(e, channel=f"{locator}.{e.channel}", groups=(axis_group(locator),)) for e in effects)


@cache
def hall_effects() -> tuple[Effect, ...]:
    """Effects common to all locators: thermal growth of base and guides, sag of body Y that grows with its reach."""
    def growth(value: Any, p: Any, nominal: Any, temperature_difference: Any) -> Any:
        return p.coef * temperature_difference * nominal
    return (
        Effect("thermal", "ball_point", growth, (Parameter("coef", "ppm/K", (1 * ppm, 50 * ppm)),), "base",
               source="expansion of base and guides; steel 11.5 ppm/K"),
        Effect("gravity_sag", "dz_y", lambda value, p, reach: -p.k * reach,
               (Parameter("k", "um/m", (5e-6, 2e-3)),), "all", source="bending under the weight of the part"))


@cache
def tracker_effects(blocks: tuple[int, ...]) -> tuple[Effect, ...]:
    """Effects of the tracker: drift and steps of its frame, range offset, scale and transit tilt of its readings.

    blocks: the blocks at whose beginning the station may have moved.
    """
    readings = (replace(e, channel="tracker") for e in laser_tracker.reading_effects() if e.name in TRACKER_READINGS)
    return tuple(replace(e, groups=(TARGETS,)) for e in (*laser_tracker.base_effects(blocks), *readings))


def effects(locators: Sequence[str] = ("A", "B", "C"), blocks: Sequence[int] = ()) -> tuple[Effect, ...]:
    """All named effects of a part on locators seen by a tracker.

    locators: their keys; blocks: the blocks at whose beginning the tracker may have moved.
    """
    return (*(e for key in locators for e in locator_effects(key)), *hall_effects(), *tracker_effects(tuple(blocks)))


@cache
def error_functions(locator: str) -> tuple[Effect, ...]:
    """The 21 errors of one locator as functions of the travel of their body, for identification.

    locator: its key. A position error is constant + slope f + bow f^2, an angle error constant + slope f, a squareness
    a constant; f = travel/half range. Far more than data can tell: `estimability` names what they cannot.
    """
    length, angle = (1 * um, 500 * um), (2 * arcsec, 300 * arcsec)

    def error(slot: str) -> Effect:
        words = ERROR_WORDS[slot]
        if slot in ("exy", "eyz", "ezx"):
            return Effect(words, slot, lambda value, p: p.constant, (Parameter("constant", "arcsec", angle),))
        if slot[0] == "e":
            return Effect(words, slot, lambda value, p, fraction: p.constant + p.slope * fraction,
                          tuple(Parameter(name, "arcsec", angle) for name in ("constant", "slope")))
        return Effect(words, slot, lambda value, p, fraction: p.constant + fraction * (p.slope + fraction * p.bow),
                      tuple(Parameter(name, "um", length) for name in ("constant", "slope", "bow")))
    return tuple(replace(error(slot), channel=locator, groups=(axis_group(locator),), source=SOURCE)
                 for slot in ERROR_WORDS)
