"""Refractive index of air after Ciddor (1996), and what an error of the air data does to an optical length.

An instrument that counts wavelengths shows the optical path divided by the index used: a length L in air of index n is
shown as L n/n_used. A distance meter with modulated light needs the group index, which is not here.
"""

from __future__ import annotations

from typing import Any

from casadi import exp

from . import stated

SOURCE = "Ciddor, Appl. Opt. 35 (1996) 1566-1573, refractive index of air: equations for the visible and near infrared"

# Derivatives of the phase index at 633 nm, 20 degC, 101 325 Pa, 50 % relative humidity and 450 ppm CO2 (a test derives
# them again).
PER_KELVIN = -0.955e-6           # [1/K], at constant relative humidity
PER_PASCAL = 2.68e-9             # [1/Pa]
PER_HUMIDITY = -0.85e-6          # for the whole range of relative humidity, 0 to 1 [1]
PER_CARBON_DIOXIDE = 1.43e-4     # for a molar fraction [1]

_GAS_CONSTANT = 8.314510         # J/(mol K), the value Ciddor's densities were formed with
_MOLAR_MASS_WATER = 0.018015     # kg/mol
_ZERO_CELSIUS = 273.15           # K


def _compressibility(temperature: Any, pressure: Any, water: Any) -> Any:
    """Ciddor (1996), eq (12)."""
    t = temperature - _ZERO_CELSIUS
    ratio = pressure / temperature
    return (1 - ratio * (1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2 + (5.707e-6 - 2.051e-8 * t) * water
                         + (1.9898e-4 - 2.376e-6 * t) * water**2)
            + ratio**2 * (1.83e-11 - 0.765e-8 * water**2))


def _molar_density(temperature: Any, pressure: Any, water: Any) -> Any:
    return pressure / (_compressibility(temperature, pressure, water) * _GAS_CONSTANT * temperature)


def saturation_pressure(temperature: Any) -> Any:
    """Saturation pressure of water vapour over water.

    temperature [K]. Returns [Pa]. Source: Ciddor (1996), appendix A (after Davis 1992).
    """
    return exp(1.2378847e-5 * temperature**2 - 1.9121316e-2 * temperature + 33.93711047 - 6.3431645e3 / temperature)


def water_fraction(temperature: Any, pressure: Any, vapour_pressure: Any) -> Any:
    """Molar fraction of water vapour, with the enhancement factor of moist air.

    temperature [K]; pressure of the air [Pa]; vapour_pressure [Pa] = relative humidity times `saturation_pressure`.
    Returns the fraction [1]. Source: Ciddor (1996), appendix A.
    """
    t = temperature - _ZERO_CELSIUS
    return (1.00062 + 3.14e-8 * pressure + 5.6e-7 * t**2) * vapour_pressure / pressure


def phase_index(wavelength: Any, temperature: Any, pressure: Any, water: Any, carbon_dioxide: Any) -> Any:
    """Phase refractive index of moist air.

    wavelength: in vacuum, 0.3 to 1.7 um [m]; temperature, -40 to 100 degC [K]; pressure, 80 to 120 kPa [Pa]; water:
    molar fraction of water vapour, from `water_fraction` [1]; carbon_dioxide: molar fraction, such as 450e-6 [1].
    Floats or CasADi.
    Returns n. Source: Ciddor (1996), eq (1)-(5), (12) and the steps of appendix B.
    """
    wave_number_2 = (1e-6 / wavelength) ** 2
    standard_air = 1e-8 * (5792105 / (238.0185 - wave_number_2) + 167917 / (57.362 - wave_number_2))
    dry_air = standard_air * (1 + 0.534 * (carbon_dioxide - 450e-6))
    vapour = 1.022e-8 * (295.235 + 2.6422 * wave_number_2 - 0.032380 * wave_number_2**2 + 0.004028 * wave_number_2**3)
    # Densities enter as ratios to their reference states (dry air at 15 degC, 101 325 Pa; pure vapour at 20 degC,
    # 1333 Pa), in which the molar masses of air and water cancel.
    density = _molar_density(temperature, pressure, water)
    return (1 + dry_air * density * (1 - water) / _molar_density(288.15, 101325.0, 0.0)
            + vapour * density * water / _molar_density(293.15, 1333.0, 1.0))


def moist_air_index(wavelength: Any, temperature: Any, pressure: Any, relative_humidity: Any,
                    carbon_dioxide: Any) -> Any:
    """Phase refractive index from what stands on the wall: `phase_index` with the humidity relative.

    relative_humidity: 0 to 1 [1]; the other arguments as for `phase_index`. Returns n.
    """
    vapour_pressure = relative_humidity * saturation_pressure(temperature)
    return phase_index(wavelength, temperature, pressure, water_fraction(temperature, pressure, vapour_pressure),
                       carbon_dioxide)


def stated_uncertainty(u_temperature: float, u_pressure: float, u_humidity: float, u_carbon_dioxide: float,
                       u_equation: float = 1e-8) -> stated.Lines:
    """Standard uncertainty of the phase index, that is of an optical length in parts of itself, near 20 degC and 1 atm.

    u_temperature [K], u_pressure [Pa], u_humidity: of the relative humidity, 0 to 1 [1], u_carbon_dioxide: of the molar
    fraction [1]; u_equation: of the equation itself [1]. The error is common to all readings of one air: give it as a
    prior on the effect `scale` rather than to each reading.
    Returns one line each [1]. Source: derivatives of Ciddor's index; for the equation the order of its agreement with
    measurement in laboratory air, Boensch and Potulski, Metrologia 35 (1998) 133-139.
    """
    return stated.Lines({"equation": u_equation, "temperature": abs(PER_KELVIN) * u_temperature,
                         "pressure": PER_PASCAL * u_pressure, "humidity": abs(PER_HUMIDITY) * u_humidity,
                         "carbon dioxide": PER_CARBON_DIOXIDE * u_carbon_dioxide})
