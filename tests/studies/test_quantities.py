"""Quantities of study files: units with angles as a dimension of their own, and tolerances as on drawings."""

from collections.abc import Callable

import pytest
from scipy import constants

import aleator as al
from aleator.statistics._units import common, is_same, measure
from aleator.studies._quantities import amount, plain

# Each by hand: a turn is 6.283185307179586 rad, a degree 0.017453292519943295 rad, a minute 60 s.
PAIRS = {
    ("60 rpm", "Hz"): 1.0,
    ("60 rpm", "rad/s"): 6.283185307179586,
    ("60 1/min", "Hz"): 1.0,
    ("1 mrad", "deg"): 0.057295779513082320,
    ("1 N m/deg", "N m/rad"): 57.29577951308232,
    ("1 N m/rad", "N m"): 1.0,
    ("2 kN m s/deg", "N m s/rad"): 114591.55902616465,
    ("1 N m/rpm", "N m s/rad"): 9.549296585513721,
    ("1 rpm/s", "rad/s^2"): 0.10471975511965977,
    ("1 m²/Hz", "m² s/rad"): 0.15915494309189535,
    ("1 N m rad/s", "W"): 1.0,
    ("5 %", "-"): 0.05,
    ("0.4 %/degC", "1/K"): 0.004,
    ("1 W/(m² K)", "mW/(mm^2 K)"): 1e-3,
    ("1 1/degC", "1/K"): 1.0,
}


def test_quantities_are_converted_with_their_angles():
    assert {pair: plain(*pair) for pair in PAIRS} == pytest.approx(PAIRS, rel=1e-12)


def refusal_of(reader: Callable[[str, str], object], text: str, unit: str) -> str:
    with pytest.raises(al.ProblemError) as refused:
        reader(text, unit)
    return str(refused.value)


@pytest.mark.parametrize(
    ("text", "unit", "word"),
    [
        ("60 1/min", "rad/s", "expected a unit with the angles of 'rad/s'; received '1/min', which has no angle"),
        ("1 kg2", "kg", "Write factors apart, powers with '^'"),
        ("1 J/kg K", "J/(kg K)", "received 'J/kg K'. Write factors apart, powers with '^', and brackets"),
        ("1/8 in", "mm", "expected one number, with a decimal point"),
        ("1,5 V", "V", "expected one number, with a decimal point"),
        ("25 degC", "K", "received 'degC'. Write '298.15 K', or '25 K' if it is a difference or a spread."),
        ("9 degF", "K", "or '5 K' if it is a difference"),
        ("1 ± 0.1 mm", "mm", "without tolerances"),
        ("20 dB", "Np", "expected a unit that can be converted to 'Np'; received 'dB'"),
    ],
)
def test_quantities_that_have_two_meanings_or_none_are_refused(text: str, unit: str, word: str):
    assert word in refusal_of(plain, text, unit)


def test_percentages_of_a_value_are_refused():
    """Before a unit they are of the value to people, and a factor of the unit to pint."""
    for text in ("20 % V", "50 ± 20 % V", "50 ± 20 %", "50 V ± 20 %", "50 ± 2 ppm V", "50 +20/-10 % V"):
        assert "expected absolute amounts, such as '50 ± 10 V', no percentage" in refusal_of(amount, text, "V")
    assert "such as '50 ± 10', no percentage" in refusal_of(amount, "0.9 ± 5 %", "-")


ZONES = {
    "20 -0.02/-0.04 mm": (19.96, 19.98),
    "20 +0.1/0 mm": (20.0, 20.1),
    "8 +0.1 0 mm": (8.0, 8.1),
    "20 +-0.1 mm": (19.9, 20.1),
    "20 +0.05/\N{MINUS SIGN}0.02 mm": (19.98, 20.05),
    "2 ± 0.01 cm": (19.9, 20.1),
    "20 ±0.1": (19.9, 20.1),
    "20 \N{MINUS SIGN}0.1/+0.1 mm": (19.9, 20.1),
    # atopile/atopile#436 read an upper limit twice; a unit at the end is that of both numbers.
    "50 +/- 10mm": (40.0, 60.0),
    "50 +- 10 um": (0.04, 0.06),
}


def test_tolerances_are_those_of_drawings():
    for text, limits in ZONES.items():
        zone = amount(text, "mm")
        assert isinstance(zone, al.Toleranced), text
        assert [float(one) for one in zone.limits()] == pytest.approx(limits, rel=1e-12), text
    share = amount("5 % ± 1 %", "-")
    assert isinstance(share, al.Toleranced)
    assert [float(one) for one in share.limits()] == pytest.approx([0.04, 0.06], rel=1e-12)
    for unit in ("1/min", "m s-1"):  # a unit may begin with a number, or end in a power
        zone = amount(f"20 ± 0.5 {unit}", unit)
        assert isinstance(zone, al.Toleranced)
        assert [float(one) for one in zone.limits()] == [19.5, 20.5]


# --- What units written as text measure, against SciPy's table of constants and dimensional analysis on paper ---------


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
    units += ["m/", "m//s", "m + s", "m^", "²", "m²³⁻", "dB", "dBm", "octave"]
    assert [unit for unit in units if measure(unit) is not None] == []
