"""What units written as text measure, against SciPy's table of constants and dimensional analysis on paper."""

import pytest
from scipy import constants

from aleator.statistics._units import common, is_same, measure


def known(unit):
    found = measure(unit)
    assert found is not None, unit
    return found


# fmt: off
WRITTEN = [
    ("N m", "N·m"), ("N m", "N*m"), ("N m", "Nm"), ("J", "N m"), ("J", "kg m²/s²"), ("J", "kg m^2 s^-2"),
    ("J", "kg*m**2/s**2"), ("m/s", "m s^-1"), ("m/s", "m s⁻¹"), ("m/s", "m s-1"), ("m/s", "(m/s)"),
    ("N/(m s)", "N/m/s"), ("W/(m² K)", "W m^(-2) K^-1"), ("N m s/rad", "N m s"), ("(N m)² s", "N² m² s"),
    ("W", "J/s"), ("V", "W/A"), ("\u2126", "V/A"), ("\u03a9", "ohm"), ("T", "Wb/m2"), ("H", "Wb/A"),
    ("MPa", "N/mm²"), ("\u00b5m", "\u03bcm"), ("um", "\u03bcm"), ("L", "dm³"), ("Hz", "1/s"), ("°", "deg"),
    ("-", "1"), ("kg.m2/s2", "N.m"), ("kWh", "kW h"), ("km/h", "1/(h/km)"), ("°C", "K"),
]
# fmt: on


def test_one_unit_may_be_written_in_several_ways():
    assert [pair for pair in WRITTEN if not is_same(*pair)] == []
    assert common(["N m", "N·m", "J"]) == "N m"


# fmt: off
SIZES = [
    ("deg", "rad", constants.degree), ("min", "s", constants.minute), ("h", "s", constants.hour),
    ("d", "s", constants.day), ("in", "m", constants.inch), ("ft", "m", constants.foot),
    ("yd", "m", constants.yard), ("mi", "m", constants.mile), ("mph", "m/s", constants.mph),
    ("km/h", "m/s", constants.kmh), ("lb", "kg", constants.lb), ("lbf", "N", constants.lbf),
    ("psi", "Pa", constants.psi), ("bar", "Pa", constants.bar), ("eV", "J", constants.eV),
    ("L", "m³", constants.liter), ("t", "kg", constants.metric_ton), ("degF", "K", constants.degree_Fahrenheit),
    ("daN", "N", constants.deka), ("mm", "m", constants.milli), ("nm", "m", constants.nano),
    ("MN", "N", constants.mega), ("kg", "kg", 1.0), ("mg", "kg", 1e-6), ("%", "-", 1e-2), ("mm²", "m²", 1e-6),
    ("kN/mm", "N/m", 1e6),
]
# fmt: on


def test_sizes_are_those_of_scipys_constants():
    for unit, si, size in SIZES:
        assert known(unit).powers == known(si).powers, unit
        assert known(unit).per(known(si)) == pytest.approx(size, rel=1e-12), unit


def test_a_turn_per_second_is_no_radian_per_second_and_may_be_no_plain_rate():
    assert [known(unit).per(known("rad/s")) for unit in ("Hz", "rpm", "1/s")] == [
        pytest.approx(2 * constants.pi),
        pytest.approx(constants.pi / 30),
        None,
    ]
    assert not is_same("rad", "-")


def test_what_can_be_read_in_two_ways_or_in_none_is_not_known():
    units = ["", "W/m² K", "W/m² * K", "W/(m² s) K", "bananas", "$", "N m)", "(N", "kg-m", "10 N", "CO2", "N2"]
    units += ["m/", "m//s", "m + s", "m^", "²", "m²³⁻"]
    assert [unit for unit in units if measure(unit) is not None] == []
